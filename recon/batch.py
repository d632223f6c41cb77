"""Many clips: processes here, a cluster through shards; a manifest that can be resumed."""

import hashlib
import json
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from recon.settings import FitSettings


@dataclass(frozen=True)
class Clip:
    """One line of a manifest."""

    name: str
    observations: tuple[Path, ...]


def read_manifest(path: Path) -> tuple[Clip, ...]:
    """The clips of a manifest: a JSON object per line, {"id": ..., "observations": [...]}.

    Paths are relative to the manifest.

    Raises:
        FileNotFoundError: when there is no such manifest.
        ValueError: when a line is not such an object or an id occurs twice; it is named.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such manifest")
    clips: list[Clip] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
            name, files = str(row["id"]), [row["observations"]]
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(
                f'{path}, line {number}: expected {{"id": "clip", "observations": ["clip.npz"]}}, '
                f"got {line[:80]!r} ({error})"
            ) from error
        files = files[0] if isinstance(files[0], list) else files
        if name != Path(name).name or name in ("", ".", ".."):
            raise ValueError(f"{path}, line {number}: an id names a file, so not {name!r}")
        clips.append(Clip(name, tuple(path.parent / str(file) for file in files)))
    names = [clip.name for clip in clips]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{path}: ids occur twice: {', '.join(twice)}")
    return tuple(clips)


def shard(clips: Sequence[Clip], index: int, count: int) -> tuple[Clip, ...]:
    """The clips of one of `count` equal workers, by hash of their id: the same every time."""
    if not 0 <= index < count:
        raise ValueError(f"--shard is I/N with 0 <= I < N, got {index}/{count}")
    return tuple(
        clip
        for clip in clips
        if int(hashlib.sha256(clip.name.encode()).hexdigest(), 16) % count == index
    )


def fit_all(
    clips: Sequence[Clip], out: Path, settings: FitSettings, processes: int, log: Path
) -> Iterator[dict[str, Any]]:
    """Fit every clip that is not done yet; yields and logs one record per clip.

    A clip is done when the log has it as ok with the same settings and inputs. A clip that fails
    is recorded with its reason; a process that dies is recorded as crashed, the others go on.
    """
    out.mkdir(parents=True, exist_ok=True)
    done = _done(log)
    waiting: list[Clip] = []
    for clip in clips:
        if done.get(clip.name) == _key(clip, settings) and _target(out, clip).exists():
            yield {"id": clip.name, "status": "skipped"}
        else:
            waiting.append(clip)
    with log.open("a", encoding="utf-8") as lines:
        for record in _run(waiting, out, settings, processes):
            lines.write(json.dumps(record) + "\n")
            lines.flush()
            yield record


def _run(
    clips: Sequence[Clip], out: Path, settings: FitSettings, processes: int
) -> Iterator[dict[str, Any]]:
    """A pool of processes; clips lost in a crash run again, each in a pool of its own."""
    lost: list[Clip] = []
    with _pool(processes) as pool:
        jobs: dict[Future[dict[str, Any]], Clip] = {
            pool.submit(_fit_one, clip, out, settings): clip for clip in clips
        }
        for job in as_completed(jobs):
            try:
                yield job.result()
            except BrokenProcessPool:
                lost.append(jobs[job])
    for clip in lost:
        with _pool(1) as pool:
            try:
                yield pool.submit(_fit_one, clip, out, settings).result()
            except BrokenProcessPool:
                yield {"id": clip.name, "status": "crashed", "error": "its process died"}


def _pool(processes: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_one_thread)


def _one_thread() -> None:
    """A clip per core is the fastest use of a machine; more threads each would fight."""
    os.environ["OMP_NUM_THREADS"] = "1"
    import torch

    torch.set_num_threads(1)


def _fit_one(clip: Clip, out: Path, settings: FitSettings) -> dict[str, Any]:
    from recon.fit_files import fit_files

    began = time.perf_counter()
    record: dict[str, Any] = {"id": clip.name, "output": str(_target(out, clip))}
    try:
        report = fit_files(clip.observations, _target(out, clip), settings)
    except (ValueError, OSError) as error:
        return record | {"status": "bad input", "error": str(error)}
    status = "failed" if report["failed"] else "ok"
    seconds = round(time.perf_counter() - began, 3)
    return record | {"status": status, "seconds": seconds, "key": _key(clip, settings)}


def _target(out: Path, clip: Clip) -> Path:
    return out / f"{clip.name}.npz"


def _key(clip: Clip, settings: FitSettings) -> str:
    """What the result depends on: settings and the inputs' contents."""
    digest = hashlib.sha256(json.dumps(asdict(settings), default=str).encode())
    for path in clip.observations:
        digest.update(path.read_bytes() if path.is_file() else b"missing")
    return digest.hexdigest()[:16]


def _done(log: Path) -> dict[str, str]:
    """Id to key of the clips that a former run finished; a line cut short is not finished."""
    done: dict[str, str] = {}
    if not log.is_file():
        return done
    for line in log.read_text(encoding="utf-8").splitlines():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        if row.get("status") == "ok":
            done[row["id"]] = row["key"]
    return done
