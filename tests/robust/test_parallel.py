"""Several runs at once: locks, threads, and processes that are forked or spawned."""

import json
import multiprocessing
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from tests.robust.doors import refused_by_command, started


def joints_of(path: str) -> np.ndarray:
    """Joints of a short fit with the pose prior."""
    torch.set_num_threads(1)
    return recon.fit(path, "pose").joints.numpy()


def test_two_batches_do_not_share_a_folder(seen: Path, tmp_path: Path) -> None:
    rows = [{"id": name, "observations": "seen.npz"} for name in "abc"]
    (tmp_path / "clips.jsonl").write_text("\n".join(map(json.dumps, rows)))
    words = ("batch", tmp_path / "clips.jsonl", "--out", tmp_path / "out", "--prior", "pose")
    first = started(*words)
    while first.poll() is None and not (tmp_path / "out" / "log.jsonl").exists():
        time.sleep(0.002)
    time.sleep(0.05)  # it is opened before it is locked
    os.killpg(first.pid, signal.SIGSTOP)
    try:
        said = refused_by_command(*words)
        assert "another run is writing" in said
    finally:
        os.killpg(first.pid, signal.SIGKILL)
        first.communicate()


@pytest.fixture(scope="module")
def alone(whole: Path) -> np.ndarray:
    """Joints of the fit that others are compared with."""
    return joints_of(str(whole / "joints3d.npz"))


def test_threads_do_not_disturb_each_other(seen: Path, alone: np.ndarray) -> None:
    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(joints_of, [str(seen)] * 2))
    assert all(np.array_equal(alone, other) for other in together)


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_processes_give_what_this_one_gives(seen: Path, alone: np.ndarray, method: str) -> None:
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"this system cannot {method}")
    with multiprocessing.get_context(method).Pool(1) as pool:
        (other,) = pool.map(joints_of, [str(seen)])
    assert np.abs(alone - other).max() < 1e-4  # metres; a new process may have other kernels
