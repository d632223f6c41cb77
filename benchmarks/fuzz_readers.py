"""Ten thousand damaged files through every reader.

    python -m benchmarks.fuzz_readers --count 10000 --recordings DATA --json OUT.json

Seeds are whole files of every format, real ones where there is a folder of recordings; each mutant
is one of them, damaged in one to three ways. Asked of every one: a ValueError that names what is
wrong, or a record whose numbers all lie within `recon.core.limits`; in 20 s of computing and 2 GB.
Mutants run in processes of their own, so that one that ends its process ends nothing else.
"""

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz_mutations import Mutation
from benchmarks.fuzz_plausible import implausible
from benchmarks.fuzz_seeds import Seed, seeds
from benchmarks.results import recordings_source, write
from recon.core.errors import ReconError

SECONDS, MEMORY = 20.0, 2 << 30
"""Computing and memory that a file may take."""
_PATIENCE = 600.0
"""Seconds without a word after which a process is taken to hang."""


def main() -> None:
    """Damage, read, judge, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--range", type=int, nargs=2, help="these mutants, in this process")
    arguments = parser.parse_args()
    if arguments.range is not None:
        first, stop = arguments.range
        child(first, stop, arguments.seed, arguments.recordings)
        return
    edges: list[int] = np.linspace(0, arguments.count, arguments.workers + 1).astype(int).tolist()
    with ThreadPoolExecutor(arguments.workers) as pool:
        parts = pool.map(
            lambda pair: watched(pair[0], pair[1], arguments.seed, arguments.recordings),
            pairwise(edges),
        )
        verdicts = [verdict for part in parts for verdict in part]
    rows = tally(verdicts)
    faults = [v for v in verdicts if v["verdict"] not in ("refused", "read")]
    print(json.dumps(rows, indent=1), json.dumps(faults[:20], indent=1), sep="\n")
    print(f"{len(verdicts)} files, {len(faults)} faults")
    if arguments.json is not None:
        sources = recordings_source(arguments.recordings) if arguments.recordings else None
        slowest = max(verdicts, key=lambda v: v["seconds"])
        largest = max(verdicts, key=lambda v: v["bytes"])
        write(
            arguments.json, arguments.seed, sources, rows=rows, faults=faults,
            count=len(verdicts), slowest=slowest, largest=largest,
        )  # fmt: skip


def tally(verdicts: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Verdicts by kind of file."""
    rows: dict[str, Counter[str]] = {}
    for one in verdicts:
        rows.setdefault(one["kind"], Counter())[one["verdict"]] += 1
    return {kind: dict(counts) for kind, counts in sorted(rows.items())}


def watched(first: int, last: int, seed: int, recordings: Path | None) -> list[dict[str, Any]]:
    """Verdicts of some mutants; the process that reads them is begun again where it ends."""
    verdicts: list[dict[str, Any]] = []
    while first < last:
        command = [sys.executable, "-m", "benchmarks.fuzz_readers", "--seed", str(seed)]
        command += ["--range", str(first), str(last)]
        command += [] if recordings is None else ["--recordings", str(recordings)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        told: dict[str, Any] = {"number": first, "kind": "seeds", "how": "before the first file"}
        timer = [time.monotonic()]
        with ThreadPoolExecutor(1) as pool:
            pool.submit(_end_when_silent, process, timer)
            for line in process.stdout:
                timer[0] = time.monotonic()
                told = json.loads(line)
                if "verdict" in told:
                    verdicts.append(told)
            process.wait()
        if "verdict" not in told:
            verdict = f"ended its process ({process.returncode})"
            verdicts.append(told | {"verdict": verdict, "seconds": 0.0, "bytes": 0})
        first = told["number"] + 1
    return verdicts


def _end_when_silent(process: subprocess.Popen[str], timer: list[float]) -> None:
    while process.poll() is None:
        time.sleep(1.0)
        if time.monotonic() - timer[0] > _PATIENCE:
            process.kill()


def child(first: int, last: int, seed: int, recordings: Path | None) -> None:
    """Read some mutants here and print a line before and after each."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        found = [one for one in seeds(folder, recordings) if is_whole(one, folder)]
        limit = _status("VmSize") + 3 * MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        signal.signal(signal.SIGPROF, _too_slow)
        for number in range(first, last):
            one, data, how = mutant(found, number, seed)
            about = {"number": number, "kind": one.kind, "file": one.name, "how": how}
            print(json.dumps(about), flush=True)
            print(json.dumps(about | judged(one, data, folder)), flush=True)


def mutant(found: list[Seed], number: int, seed: int) -> tuple[Seed, bytes, str]:
    """One damaged file, its seed, and how it was damaged; the same for the same numbers."""
    rng = np.random.default_rng([seed, number])
    shares = np.array([one.share for one in found])
    one = found[int(rng.choice(len(found), p=shares / shares.sum()))]
    data, names = one.data, []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        mutation: Mutation = one.mutations[int(rng.integers(0, len(one.mutations)))]
        try:
            data = mutation(data, rng) or data
            names.append(mutation.__name__)
        except Exception:
            continue
    return one, data, ", ".join(names)


def is_whole(one: Seed, folder: Path) -> bool:
    """Whether the seed itself is read: some of the vendors' samples need options, or are broken.

    Raises:
        ValueError: when what is read of it is implausible: then a range is wrong.
    """
    try:
        read = one.read(written(one, one.data, folder))
    except ValueError:
        return False
    if problem := implausible(read):
        raise ValueError(f"the seed {one.name} is implausible: {problem}")
    return True


def judged(one: Seed, data: bytes, folder: Path) -> dict[str, Any]:
    """What became of one damaged file, the seconds it computed and the bytes it took."""
    path = written(one, data, folder)
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory is that from here on
    before, start = _status("VmRSS"), time.process_time()
    signal.setitimer(signal.ITIMER_PROF, 2 * SECONDS)
    try:
        verdict = outcome(one, path)
    except _TooSlowError:
        verdict = "took too long"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    seconds, taken = time.process_time() - start, _status("VmHWM") - before
    if seconds > SECONDS:
        verdict = "took too long"
    elif taken > MEMORY:
        verdict = "took too much memory"
    return {"verdict": verdict, "seconds": round(seconds, 2), "bytes": max(taken, 0)}


def outcome(one: Seed, path: Path) -> str:
    """`refused`, `read`, or what is wrong with how a damaged file was read."""
    try:
        read = one.read(path)
    except (ValueError, FileNotFoundError) as error:
        known = (path.name, path.parent.name, Path(one.name).stem)
        unnamed = not any(name in str(error) for name in known)
        ours = isinstance(error, ReconError) or type(error) in (ValueError, FileNotFoundError)
        if not ours or unnamed:
            return f"refused without naming the file: {error!r}"[:300]
        return "refused"
    except _TooSlowError:
        raise
    except BaseException:
        return f"traceback: {' '.join(traceback.format_exc().split())[-400:]}"
    problem = implausible(read)
    return f"read something implausible: {problem}" if problem else "read"


def written(one: Seed, data: bytes, folder: Path) -> Path:
    """The damaged file among the others of its folder."""
    inside = folder / "mutant"
    inside.mkdir(exist_ok=True)
    for path in inside.iterdir():
        path.unlink()
    for name, content in one.beside.items():
        (inside / name).write_bytes(content)
    (inside / one.name).write_bytes(data)
    return inside / one.name


def _status(key: str) -> int:
    """Bytes of memory of this process, as Linux counts them."""
    text = Path("/proc/self/status").read_text()
    return next(int(ln.split()[1]) << 10 for ln in text.splitlines() if ln.startswith(f"{key}:"))


class _TooSlowError(BaseException):
    """A reader took too long; it is no Exception, so that no reader catches it."""


def _too_slow(*_: object) -> None:
    raise _TooSlowError


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
