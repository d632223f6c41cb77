"""Items of which several are done by one process in a row, each with a result of its own."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from recon.jobs.many.workers import DONE, Failure, run_jobs


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
