"""Processes that each work on several clips side by side, minimising them together.

Whatever becomes of one clip, its neighbours go on: an error of one is told of that one, and where
a process dies, all that it had not finished are done again one by one.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from recon.batch.workers import DONE, Failure, failure_of, run_jobs
from recon.batch.worklog import BatchClip


@dataclass(frozen=True)
class Begun:
    """What a function gives before it works on an item of its chunk."""

    item: int
    """Index in the chunk."""


@dataclass(frozen=True)
class Ended:
    """What it gives afterwards."""

    item: int
    result: Any


def run_items(
    function: Callable[..., Any],
    chunks: Iterable[Sequence[Any]],
    processes: int,
) -> Iterator[tuple[Any, Any]]:
    """Work on chunks of items in some processes; yields items and results as they end.

    `function(chunk)` is a generator of `Begun` and `Ended`. The item at which it fails, or its
    process dies, has the `Failure` as its result, and the rest of the chunk is begun anew. Where
    it fails before any item, all that are left have the `Failure`.
    """
    jobs = _Jobs(deque(chunk for chunk in chunks if len(chunk) > 0))
    for (chunk,), message in run_jobs(function, jobs, processes):
        state = jobs.states[id(chunk)]
        if isinstance(message, Begun):
            state.begun = message.item
        elif isinstance(message, Ended):
            state.ended.add(message.item)
            yield chunk[message.item], message.result
        else:
            del jobs.states[id(chunk)]
            if message == DONE:
                message = Failure("error", "its process said nothing of it")
            left = [k for k in range(len(chunk)) if k not in state.ended]
            failed = [state.begun] if state.begun in left else left
            if rest := [chunk[k] for k in left if k not in failed]:
                jobs.chunks.append(rest)
            for k in failed:
                yield chunk[k], message


@dataclass
class _State:
    """How far a chunk is."""

    chunk: Sequence[Any]
    begun: int = -1
    """The item that was begun last."""
    ended: set[int] = field(default_factory=set)


@dataclass
class _Jobs(Iterator[tuple[Sequence[Any]]]):
    """Jobs of one chunk each; more can come after the last was drawn."""

    chunks: deque[Sequence[Any]]
    states: dict[int, _State] = field(default_factory=dict)

    def __next__(self) -> tuple[Sequence[Any]]:
        if len(self.chunks) == 0:
            raise StopIteration
        chunk = self.chunks.popleft()
        self.states[id(chunk)] = _State(chunk)
        return (chunk,)


TOGETHER = 1000
"""Frames of several clips that a process minimises together at most."""
_MOST = 16
"""Clips that a process has begun at most: more save little time, and all of them take memory."""


Run = Callable[
    [Callable[..., Any], Iterable[tuple[Any, ...]], int], Iterator[tuple[tuple[Any, ...], Any]]
]
"""What `recon.batch.workers.run_jobs` does, in processes here or elsewhere."""


@dataclass(frozen=True)
class Crew:
    """How many processes work at a time, on how much each, and where they run."""

    processes: int
    together: int = TOGETHER
    """Frames of several clips that a process minimises together at most; with 1, a process works
    on one clip at a time."""
    run: Run = run_jobs

    def __post_init__(self) -> None:
        """Refuse a crew that could do nothing."""
        if self.processes < 1:
            raise ValueError(f"expected at least one process, got {self.processes}")
        if self.together < 1:
            raise ValueError(f"expected at least one frame at a time, got {self.together}")

    def groups(self, clips: Sequence[BatchClip]) -> Iterator[list[BatchClip]]:
        """Clips that a process has at a time, of about one size in bytes; the large ones first.

        So clips of like length are in one group, and no process ends long after the others.
        """
        count = min(_MOST, -(-len(clips) // self.processes)) if self.together > 1 else 1
        ordered = sorted(clips, key=_size, reverse=True)
        return (ordered[k : k + count] for k in range(0, len(ordered), count))

    def work(
        self, function: Callable[[Any], Any], groups: Iterable[Sequence[Any]]
    ) -> Iterator[tuple[Any, Any]]:
        """Call a function for every job of some groups; yields jobs and results as they end.

        A result is what the function returned, or a `Failure`.
        """
        queue = _Queue(groups)
        several = partial(side_by_side, function, self.together)
        for (number, group), message in self.run(several, queue, self.processes):
            left = queue.left[number]
            if isinstance(message, Ended):
                left.discard(message.item)
                yield group[message.item], message.result
                continue
            del queue.left[number]
            if message == DONE and left:
                message = Failure("error", "its process said nothing of it")
            for k in sorted(left):
                if len(group) == 1:
                    yield group[k], message
                else:
                    queue.again.append([group[k]])


def side_by_side(
    function: Callable[[Any], Any], frames: int, number: int, jobs: Sequence[Any]
) -> Iterator[Ended]:
    """Call a function for several jobs, whose fits share their minimisations.

    What the only job of a group raises is raised here.

    Args:
        function: what is done for a job.
        frames: that are minimised together at most.
        number: of the group.
        jobs: the group.

    Raises:
        MemoryError: when one of them raised it, as nobody knows what is left of memory.
    """
    del number  # for those who wait for the results
    if len(jobs) == 1:
        yield Ended(0, function(jobs[0]))
        return
    from recon.batch.together import Raised, ended_together

    for k, outcome in ended_together([partial(function, job) for job in jobs], frames):
        if not isinstance(outcome, Raised):
            yield Ended(k, outcome)
        elif isinstance(outcome.error, MemoryError):
            raise outcome.error
        else:
            yield Ended(k, failure_of(outcome.error))


@dataclass
class _Queue(Iterator[tuple[int, Sequence[Any]]]):
    """Groups with their numbers; more can come after the last was drawn."""

    groups: Iterable[Sequence[Any]]
    again: deque[Sequence[Any]] = field(default_factory=deque)
    """Groups that come after all others."""
    left: dict[int, set[int]] = field(default_factory=dict)
    """Jobs that have not ended, by the number of their group and their own in it."""

    def __post_init__(self) -> None:
        self._drawn = iter(self.groups)
        self._count = 0

    def __next__(self) -> tuple[int, Sequence[Any]]:
        group = next(self._drawn, None)
        if group is None:
            if len(self.again) == 0:
                raise StopIteration
            group = self.again.popleft()
        number, self._count = self._count, self._count + 1
        self.left[number] = set(range(len(group)))
        return number, group


def _size(clip: BatchClip) -> tuple[str, int]:
    """The kind and the size of a clip's first observation; those of one kind can be compared.

    That of a folder is the number of files in it. What is not there is refused by its own fit.
    """
    if len(clip.observations) == 0:
        return "", 0
    path = clip.observations[0]
    try:
        if path.is_dir():
            return "/", sum(1 for _ in path.iterdir())
        return path.suffix.lower(), path.stat().st_size
    except OSError:
        return "", 0
