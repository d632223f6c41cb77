"""Small real jobs for tests of batches, and ten ways in which one of them goes wrong.

As a program it runs a batch, to be killed by a test: MANIFEST OUT [SECONDS per clip].
"""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from recon.batch.batch import FitJob, fit_all, fit_one, is_done
from recon.batch.workers import result_or_failure
from recon.batch.worklog import Record, read_manifest
from recon.fitting.settings import FitSettings
from recon.formats.opening import load_arrays
from recon.formats.replacing import file_checksum, save_arrays
from recon.reading.inputs import clip_checksum


class Odd(Exception):
    """Cannot be made again from its text, which is what pickle tries."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(one + two)


def recurse(depth: int = 0) -> int:
    return recurse(depth + 1)


def refuse() -> None:
    raise ValueError("expected metres, got parsecs")


def exhaust() -> None:
    raise MemoryError


def overflow() -> None:
    int(float("inf"))


def divide() -> None:
    np.linalg.inv(np.zeros((2, 2)))


def odd() -> None:
    raise Odd("left", "right")


def be_killed() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def abort() -> None:
    os.kill(os.getpid(), signal.SIGABRT)


def leave() -> None:
    sys.exit(3)


def miss() -> None:
    Path("/nowhere/at/all").read_bytes()


WAYS = {
    "refuse": (refuse, "bad input"), "recurse": (recurse, "error"),
    "exhaust": (exhaust, "out of memory"),
    "overflow": (overflow, "error"), "divide": (divide, "error"), "odd": (odd, "error"),
    "be_killed": (be_killed, "crashed"), "abort": (abort, "crashed"), "leave": (leave, "crashed"),
    "miss": (miss, "bad input"),
}  # fmt: skip
"""What a clip of such a name does, and how the log has it."""


def sum_one(job: FitJob) -> Record:
    """Write the sum of the first observation, slowly; or go wrong as the clip is called."""
    if job.clip.name in WAYS:
        WAYS[job.clip.name][0]()
    key = clip_checksum(job.clip.observations, job.settings_checksum)
    record: Record = {"id": job.clip.name, "output": str(job.target)}
    if is_done(job, key):
        return record | {"status": "skipped"}
    total = load_arrays(job.clip.observations[0])["positions"].sum()
    time.sleep(float(os.environ.get("SECONDS_PER_CLIP", "0")))
    save_arrays(job.target, {"total": np.array(total)})
    return record | {"status": "ok", "key": key, "checksum": file_checksum(job.target)}


def fit_or_go_wrong(job: FitJob) -> Record:
    """A real fit; or go wrong as the clip is called."""
    if job.clip.name in WAYS:
        WAYS[job.clip.name][0]()
    return fit_one(job)


def here(function, jobs, processes):
    """What `run_jobs` does without processes of their own, whose start takes seconds."""
    del processes
    for job in jobs:
        yield job, result_or_failure(function, job)


if __name__ == "__main__":
    manifest, out, kind = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    settings = FitSettings(prior="pose")
    work = fit_or_go_wrong if kind == "fit" else sum_one
    log = out / "log.jsonl"
    for record in fit_all(read_manifest(manifest), out, settings, 2, log, work):
        sys.stdout.write(f"{record['id']} {record['status']}\n")
        sys.stdout.flush()
