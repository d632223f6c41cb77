"""Runs that are killed at any moment, and run again, end as if nothing had happened."""

import json
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import recon
from tests.robust.doors import DONE, files_below, started

MOMENTS = (0.0, 0.4)
"""Seconds after the first sign of work at which a run is killed."""


def killed(words: Sequence[str | Path], watched: Path, seconds: float) -> None:
    """Start a run and kill its processes so long after something new is in a folder."""
    before = set(os.listdir(watched)) if watched.is_dir() else set()
    process = started(*words)
    while process.poll() is None:
        if watched.is_dir() and set(os.listdir(watched)) - before:
            break
        time.sleep(0.002)
    time.sleep(seconds)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def ended(words: Sequence[str | Path]) -> None:
    process = started(*words)
    _, said = process.communicate()
    assert process.returncode == DONE, said


def test_a_killed_fit_leaves_no_half_result(seen: Path) -> None:
    out = seen.parent / "out"
    words = ("fit", seen, "--prior", "pose", "--out", out / "motion.npz")
    for moment in MOMENTS:
        killed(words, out, moment)
        if (out / "motion.npz").exists():
            assert recon.load_motion(out / "motion.npz").motion.frames == 12
    ended(words)
    assert files_below(out) == {"motion.npz", "motion.npz.json"}
    assert json.loads((out / "motion.npz.json").read_text())["failed"] is False


@pytest.mark.slow
def test_a_killed_batch_has_every_clip_once(whole: Path, tmp_path: Path) -> None:
    names = ["a", "b"]
    rows = [{"id": name, "observations": str(whole / "joints3d.npz")} for name in names]
    (tmp_path / "clips.jsonl").write_text("\n".join(map(json.dumps, rows)))
    out = tmp_path / "out"
    words = ("batch", tmp_path / "clips.jsonl", "--out", out, "--prior", "pose")
    killed(words, out, 0.3)
    for path in out.glob("?.npz"):
        assert recon.load_motion(path).motion.frames == 12
    ended(words)
    logged = [json.loads(line)["id"] for line in (out / "log.jsonl").read_text().splitlines()]
    assert sorted(logged) == names
    assert {name for name in files_below(out) if name.endswith(".npz")} == {
        f"{name}.npz" for name in names
    }
    joints = [np.load(out / f"{name}.npz")["joints"] for name in names]
    assert max(float(np.abs(one - joints[0]).max()) for one in joints) < 1e-3


@pytest.mark.slow
def test_a_killed_conversion_of_a_folder_goes_on(whole: Path, tmp_path: Path) -> None:
    names = ["a", "b"]
    (tmp_path / "in").mkdir()
    head, rows = (whole / "walk.bvh").read_text().split("Frame Time: ")
    time_of_a_frame, rows = rows.split("\n", 1)
    text = head.replace("Frames: 10", "Frames: 40") + f"Frame Time: {time_of_a_frame}\n"
    for name in names:
        (tmp_path / "in" / f"{name}.bvh").write_text(text + (rows.rstrip("\n") + "\n") * 4)
    out = tmp_path / "out"
    words = ("convert", tmp_path / "in", out, "--all")
    killed(words, out, 0.3)
    ended(words)
    motions = sorted(out.rglob("*.npz"))
    assert [path.stem for path in motions] == names
    assert {recon.load_motion(path).motion.frames for path in motions} == {40}
