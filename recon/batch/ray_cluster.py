"""Runs jobs on a Ray cluster, with the same log and resuming as in local processes.

Ray starts the processes and notices when one, or its whole machine, dies. Code is not sent:
every machine has recon installed, in the same version, and sees the same files under the same
paths. Ray is imported only here.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from recon.batch.workers import Failure, Run, as_worker, result_or_failure
from recon.core.errors import ReconError
from recon.fitting.settings import FitSettings

LOCAL = "local"
"""Address of a cluster that is begun on this machine, and ended after the work."""
_TRIES = 3
"""Number of times that a job is begun whose machine or process died, as machines come and go."""


@contextmanager
def ray_cluster(address: str, cpus: int | None = None) -> Iterator[tuple[int, Run]]:
    """Context that joins a cluster; yields the number of processors and a runner of jobs.

    Args:
        address: `local`, which begins one on this machine; `auto` for the one that this machine
            belongs to; or that of a cluster's head, such as 10.0.0.1:6379 or ray://10.0.0.1:10001.
        cpus: processors of a cluster that is begun here; None takes all.

    Raises:
        ReconError: when Ray is not installed, or there is no cluster at the address.
    """
    # imported by name, so that type checkers ignore the optional package
    try:
        ray: Any = import_module("ray")
        import_module("ray.exceptions")
    except ImportError as error:
        raise ReconError(
            "--ray needs the package Ray, which is not installed here: "
            "pip install 'motion-recon[ray]', on all machines of the cluster"
        ) from error
    joined = not ray.is_initialized()
    if joined:
        _join_cluster(ray, address, cpus)
    try:
        known = ray.cluster_resources().get("CPU", 1)
        yield max(int(known), 1), partial(_run_on_cluster, ray)
    finally:
        if joined:
            ray.shutdown()


def with_absolute_paths(settings: FitSettings) -> FitSettings:
    """The settings with absolute paths, since a cluster's processes start in other folders."""
    found: dict[str, Any] = {}
    for field in fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, Path):
            found[field.name] = value.absolute()
    for name in ("weights", "shape"):
        if Path(text := getattr(settings, name) or "").is_file():
            found[name] = str(Path(text).absolute())
    return replace(settings, **found)


def _join_cluster(ray: Any, address: str, cpus: int | None) -> None:
    # do not send usage statistics
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    quiet = {"log_to_driver": False, "logging_level": "ERROR"}
    try:
        if address == LOCAL:
            ray.init(address=LOCAL, num_cpus=cpus, include_dashboard=False, **quiet)
        else:
            ray.init(address=address, **quiet)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise ReconError(
            f"--ray {address}: no cluster could be joined ({error}); expected `local`, `auto` or "
            "the address of a cluster's head, such as 10.0.0.1:6379 (`ray status` there tells it)"
        ) from error


def _run_on_cluster(
    ray: Any,
    function: Callable[..., Any],
    jobs: Iterable[tuple[Any, ...]],
    processes: int,
) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Run jobs on the cluster; yields jobs and results as they end, like `run_jobs`."""
    remote = ray.remote(num_cpus=1, max_retries=0)(_result_as_worker)
    drawn, busy = iter(jobs), dict[Any, tuple[tuple[Any, ...], int]]()
    try:
        while True:
            while len(busy) < processes and (job := next(drawn, None)) is not None:
                busy[remote.remote(function, job)] = job, 1
            if not busy:
                return
            (ready,), _ = ray.wait(list(busy), num_returns=1)
            job, tries = busy.pop(ready)
            result = _result_or_failure(ray, ready)
            if isinstance(result, Failure) and result.kind == "crashed" and tries < _TRIES:
                busy[remote.remote(function, job)] = job, tries + 1
            else:
                yield job, result
    finally:
        for one in busy:
            ray.cancel(one, force=True)


def _result_as_worker(function: Callable[..., Any], job: tuple[Any, ...]) -> Any:
    """Run a job in a process of the cluster, like `recon.batch.workers.result_or_failure`."""
    as_worker()
    return result_or_failure(function, job)


def _result_or_failure(ray: Any, reference: Any) -> Any:
    """Wait for a job on the cluster; return its result, or a `Failure` if its process died."""
    known = ray.exceptions
    try:
        return ray.get(reference)
    except known.OutOfMemoryError as error:
        return Failure("out of memory", _first_line(error))
    except (known.WorkerCrashedError, known.NodeDiedError, known.LocalRayletDiedError) as error:
        return Failure("crashed", f"its process or machine died: {_first_line(error)}")
    except known.RayError as error:
        return Failure("error", _first_line(error), str(error))


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]
