"""Runs jobs in separate processes, which continue when one fails or dies.

A job that raises anything, runs out of memory or takes its process down ends as a `Failure` with
its reason. Unlike in `concurrent.futures`, a process that dies costs its own job alone.
"""

import contextlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, Literal

Kind = Literal["bad input", "out of memory", "crashed", "error"]
"""Kinds of failure: the input, or the place for the output, was refused (`_REFUSALS`); there was
no memory; the process died; anything else, which no good program should raise."""

_REFUSALS = (
    ValueError, FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError,
    PermissionError,
)  # fmt: skip

_PATIENCE = 5.0
"""Seconds that a process has to clean up when it is told to end."""


@dataclass(frozen=True)
class Failure:
    """The reason why a job gave no result."""

    kind: Kind
    reason: str
    traceback: str = ""
    """Traceback of an unexpected error; empty where the reason says all."""

    @property
    def record(self) -> dict[str, str]:
        """The failure's status and reason as fields for the log."""
        said = {"status": self.kind, "error": self.reason}
        return said | ({"traceback": self.traceback} if self.traceback else {})


Run = Callable[
    [Callable[..., Any], Iterable[tuple[Any, ...]], int], Iterator[tuple[tuple[Any, ...], Any]]
]
"""What `run_jobs` does, in processes here or elsewhere."""


def run_jobs(
    function: Callable[..., Any], jobs: Iterable[tuple[Any, ...]], processes: int
) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Call `function(*job)` for all jobs in parallel; yields jobs and results as they end.

    The result is what the function returned, or a `Failure`. Jobs are drawn when a process is free
    for them. When the caller stops iterating, or is killed, the processes end.

    Args:
        function: importable, as its process has to find it; so are jobs and results.
        jobs: arguments of each call.
        processes: that work at once, each with one thread.

    Raises:
        ValueError: when there is to be no process.
    """
    if processes < 1:
        raise ValueError(f"expected at least one process, got {processes}")
    drawn = iter(jobs)
    idle: list[_Worker] = []
    busy: dict[Connection, tuple[_Worker, tuple[Any, ...]]] = {}
    try:
        while True:
            while len(busy) < processes and (job := next(drawn, None)) is not None:
                worker = idle.pop() if idle else _Worker(function)
                worker.begin(job)
                busy[worker.connection] = worker, job
            if not busy:
                return
            ready = wait(list(busy))
            for connection in [one for one in busy if one in ready]:
                worker, job = busy.pop(connection)
                result, alive = worker.result()
                if alive:
                    idle.append(worker)
                yield job, result
    finally:
        for worker in (*idle, *(worker for worker, _ in busy.values())):
            worker.stop()


class _Worker:
    """A worker process that runs jobs one after the other."""

    def __init__(self, function: Callable[..., Any]) -> None:
        # spawned, since a forked process would inherit locks of torch's threads
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=_worker_loop, args=(function, theirs), daemon=True)
        self._process.start()
        theirs.close()

    def begin(self, job: tuple[Any, ...]) -> None:
        """Send a job to the process; `result` reports whether the process has died."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.connection.send(job)

    def result(self) -> tuple[Any, bool]:
        """Receive the job's result or `Failure`, and whether the process can run another job."""
        try:
            result = self.connection.recv()
        except (EOFError, ConnectionResetError):
            self.connection.close()
            self._process.join()
            return Failure("crashed", _exit_in_words(self._process.exitcode or 0)), False
        if isinstance(result, Failure) and result.kind == "out of memory":
            # after a failed allocation the process is in an unknown state
            self.stop()
            return result, False
        return result, True

    def stop(self) -> None:
        """End the process at once; it removes half-written files."""
        self._process.terminate()
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self.connection.close()


def _exit_in_words(code: int) -> str:
    if code >= 0:
        return f"its process ended with exit code {code}"
    name = signal.Signals(-code).name
    memory = ", as a machine does that is short of memory" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{memory}"


def _worker_loop(function: Callable[..., Any], connection: Connection) -> None:
    """The loop of a worker process: run jobs from the connection until it closes."""
    # the parent process handles Ctrl-C and stops the workers
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    as_worker()
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            connection.send(result_or_failure(function, connection.recv()))


def result_or_failure(function: Callable[..., Any], job: tuple[Any, ...]) -> Any:
    """Run a job; returns its result, or the `Failure` that ended it."""
    try:
        return function(*job)
    except MemoryError as error:
        return Failure("out of memory", _error_in_words(error))
    except Exception as error:
        if _is_refusal(error):
            return Failure("bad input", str(error))
        return Failure("error", _error_in_words(error), "".join(traceback.format_exception(error)))


def _is_refusal(error: Exception) -> bool:
    """Whether an error is a refusal of bad input by recon, not a failure in a library.

    Libraries raise subclasses of ValueError, such as UnicodeDecodeError and LinAlgError.
    """
    own = type(error).__module__.partition(".")[0] in ("recon", "priors", "observations")
    return type(error) in _REFUSALS or (own and isinstance(error, ValueError))


def _error_in_words(error: Exception) -> str:
    text = str(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _end_with_parent() -> None:
    """End this process when its parent dies, so that nothing is written without a log."""
    from multiprocessing import parent_process

    parent = parent_process()
    assert parent is not None  # spawned processes have a parent
    parent.join()
    os._exit(1)


def as_worker() -> None:
    """Prepare the current process for jobs: one thread, as processes share the cores."""
    os.environ["OMP_NUM_THREADS"] = "1"
    if "torch" in sys.modules:
        import torch

        torch.set_num_threads(1)
