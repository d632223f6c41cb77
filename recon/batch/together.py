"""Functions that call `recon.solve`, run side by side so that their problems are solved together.

Each runs in a thread of its own until it asks for a solution; then the next one runs. When all
wait, problems that can be joined become one batch. So every function is the code that would run
alone, whatever it decides between its fits, and an error in one concerns no other.
"""

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from recon.batch.joining import Member, solve_joined
from recon.method.reconstruction import Problem, Reconstruction, solved_by

_LOG = logging.getLogger("recon")

FRAMES = 1000
"""Frames of all clips that are minimised together at most."""
_LIKE = 1.25
"""Ratio of the longest to the shortest clip of a batch at most: padding is computed in vain."""
_THREADS = 64
"""Functions that are begun and not yet ended at most."""

T = TypeVar("T")


@dataclass(frozen=True)
class Raised:
    """The exception with which a function ended."""

    error: Exception


def ended_together(
    functions: Sequence[Callable[[], T]], frames: int = FRAMES
) -> Iterator[tuple[int, T | Raised]]:
    """What functions return, or the exceptions they raise, by their number, as each of them ends.

    A function's calls of `recon.solve` (`recon.fit` makes several) are answered with solutions
    of batches with those of the others. Everything else of it happens as if it ran alone.

    Args:
        functions: without arguments.
        frames: that are minimised together at most; memory grows with them. A clip that is longer
            is solved alone.

    Raises:
        ValueError: when there are to be no frames.
    """
    if frames < 1:
        raise ValueError(f"expected at least one frame at a time, got {frames}")
    for first in range(0, len(functions), _THREADS):
        runners = [_Runner(one) for one in functions[first : first + _THREADS]]
        for runner, outcome in _ended(runners, frames):
            yield first + runners.index(runner), outcome


def _ended(
    runners: "Sequence[_Runner[T]]", frames: int
) -> "Iterator[tuple[_Runner[T], T | Raised]]":
    try:
        for runner in runners:
            runner.go_on()
            if runner.ended:
                yield runner, runner.outcome
        while waiting := [runner for runner in runners if not runner.ended]:
            for runner, answer in _answered(waiting, frames):
                runner.go_on(answer)
                if runner.ended:
                    yield runner, runner.outcome
    finally:
        for runner in runners:
            runner.abandon()


def _answered(
    waiting: "Sequence[_Runner[Any]]", frames: int
) -> "list[tuple[_Runner[Any], Reconstruction | Exception]]":
    """Answers to some of the functions that wait.

    The shortest course of stages is run first: quick fits prepare longer ones, for which those
    who asked early wait until the others have come as far.
    """
    first = min(waiting, key=lambda runner: (_length_of_course(runner), _frames(runner)))
    if first.member is None:
        return [(first, _alone(first.problem))]
    group = _group(first, first.member, waiting, frames)
    if len(group) == 1:
        return [(first, _alone(first.problem))]
    try:
        found = solve_joined([member for _, member in group])
    except Exception as error:
        # one of them may be to blame: its own error is told to it alone
        _LOG.info("%d clips are solved one by one: together, %r was raised", len(group), error)
        return [(runner, _alone(runner.problem)) for runner, _ in group]
    pairs = zip(group, found, strict=True)
    return [(runner, answer) for (runner, _), answer in pairs if answer is not None]


def _group(
    first: "_Runner[Any]", member: Member, waiting: "Sequence[_Runner[Any]]", frames: int
) -> "list[tuple[_Runner[Any], Member]]":
    """The functions whose problems are solved with that of the first: clips of like length."""
    length = member.lengths[0]
    others = [
        (runner, runner.member)
        for runner in waiting
        if runner is not first
        and runner.member is not None
        and _length_of_course(runner) == _length_of_course(first)
        and runner.member.beside(member)
    ]
    others.sort(key=lambda pair: abs(pair[1].lengths[0] - length))
    group, rows, least, most = [(first, member)], member.rows, length, length
    for runner, other in others:
        own = other.lengths[0]
        shorter, longer = min(least, own), max(most, own)
        if longer > _LIKE * shorter or (rows + other.rows) * longer > frames:
            break
        group.append((runner, other))
        rows, least, most = rows + other.rows, shorter, longer
    return group


def _length_of_course(runner: "_Runner[Any]") -> int:
    """Iterations that a problem may take, over all stages; none for one that is not joined."""
    if runner.member is None:
        return 0
    return sum(stage.minimiser.max_iterations for stage in runner.member.stages)


def _frames(runner: "_Runner[Any]") -> int:
    return 0 if runner.member is None else runner.member.lengths[0]


def _alone(problem: Problem) -> Reconstruction | Exception:
    try:
        return problem.solved()
    except Exception as error:
        return error


class _Abandoned(BaseException):
    """Ends a function whose solutions nobody will compute; no handler of errors stops it."""


class _Runner(Generic[T]):
    """A function in a thread, which runs only while the one who drives it waits."""

    def __init__(self, function: Callable[[], T]) -> None:
        self._function = function
        self._answer: Reconstruction | BaseException | None = None
        self._mine, self._theirs = threading.Semaphore(0), threading.Semaphore(0)
        # settings such as those of warnings and numpy are those of the caller
        context = copy_context()
        self._thread = threading.Thread(target=context.run, args=(self._run,), daemon=True)
        self._begun = self.ended = False
        self._problem: Problem | None = None
        self.member: Member | None = None
        """What it asks for, where that can be joined with others."""
        self._outcome: T | Raised | None = None
        self._leaving: BaseException | None = None

    @property
    def problem(self) -> Problem:
        """What it asks for."""
        assert self._problem is not None
        return self._problem

    @property
    def outcome(self) -> Any:
        """What the function returned or raised; it is given once, as it may be large.

        Raises:
            SystemExit, KeyboardInterrupt: when the function meant to end more than itself.
        """
        assert self.ended
        if self._leaving is not None:
            raise self._leaving
        found, self._outcome = self._outcome, None
        return found

    def go_on(self, answer: Reconstruction | BaseException | None = None) -> None:
        """Let it run, with the solution that it asked for, until it asks again or ends."""
        self._answer, self._problem, self.member = answer, None, None
        if not self._begun:
            self._begun = True
            self._thread.start()
        else:
            self._theirs.release()
        self._mine.acquire()

    def abandon(self) -> None:
        """End it where it waits."""
        if self._begun and not self.ended:
            self.go_on(_Abandoned())

    def _run(self) -> None:
        try:
            with solved_by(self._ask):
                self._outcome = self._function()
        except Exception as error:
            self._outcome = Raised(error)
        except BaseException as leaving:  # raised again by the one who waits
            self._leaving = leaving
        finally:
            self.ended = True
            self._mine.release()

    def _ask(self, problem: Problem) -> Reconstruction:
        self._problem = problem
        # here, where an error of a method's stages is raised to the one who asked
        self.member = Member.of(problem)
        if self.member is not None:
            _ = self.member.stages
        self._mine.release()
        self._theirs.acquire()
        answer, self._answer = self._answer, None
        if isinstance(answer, BaseException):
            raise answer
        assert answer is not None
        return answer
