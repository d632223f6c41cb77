"""Batches that are killed at any moment and resumed end as if nothing had happened."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from recon.batch.batch import fit_all
from recon.batch.worklog import read_manifest
from recon.body.model import BodyModel
from recon.cli import FAILED, run
from recon.core.skeleton import JOINTS
from recon.fitting.settings import FitSettings
from recon.formats.motions import load_motion
from recon.formats.observations import PositionsFile, save_observation
from recon.formats.replacing import save_arrays
from tests.batch.batch_jobs import WAYS

ROOT = Path(__file__).parents[2]


def start(folder: Path, out: Path, kind: str, seconds: float) -> subprocess.Popen[bytes]:
    environment = {
        **os.environ, "PYTHONPATH": str(ROOT), "SECONDS_PER_CLIP": str(seconds),
        "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    return subprocess.Popen(
        [sys.executable, "-m", "tests.batch.batch_jobs", folder / "clips.jsonl", out, kind],
        env=environment, cwd=ROOT, stdout=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


def finished(log: Path) -> list[dict[str, object]]:
    """Whole lines of a log."""
    data = log.read_bytes() if log.is_file() else b""
    return [json.loads(line) for line in data[: data.rfind(b"\n") + 1].splitlines()]


def killed_and_resumed(
    folder: Path, out: Path, kind: str, count: int, kills: int, seconds: float
) -> None:
    """Kill a run after about every so many clips, at a random moment of what it does then."""
    log, draw = out / "log.jsonl", random.Random(0)
    for kill in range(kills):
        process = start(folder, out, kind, seconds)
        before, wanted = len(finished(log)), count * (kill + 1) // (kills + 2)
        deadline = time.monotonic() + 600
        while process.poll() is None and len(finished(log)) < wanted:
            time.sleep(0.005)
            assert time.monotonic() < deadline, f"nothing was logged after {before} clips"
        time.sleep(draw.uniform(0, max(2 * seconds, 0.05)))
        os.killpg(process.pid, signal.SIGKILL) if kill % 2 else process.kill()
        process.wait()
    assert start(folder, out, kind, 0).wait() == 0


def compared(out: Path, plain: Path, names: list[str], tolerance: float = 0.0) -> None:
    """Every clip is once in the log, and every result is that of an uninterrupted run.

    Fits of a resumed run have other neighbours in their batches, so that sums are rounded
    differently; `tolerance` is what their joints may move on average, metres.
    """
    lines = finished(out / "log.jsonl")
    assert sorted(str(line["id"]) for line in lines) == sorted(names)
    kinds = {str(line["id"]): line["status"] for line in lines}
    assert kinds == {n: WAYS[n][1] if n in WAYS else "ok" for n in names}
    written = sorted(path.name for path in plain.glob("*.npz"))
    assert len(written) == len(names) - len(WAYS)
    assert sorted(path.name for path in out.glob("*.npz")) == written
    for name in written:
        if tolerance == 0:
            assert (out / name).read_bytes() == (plain / name).read_bytes(), name
        else:
            found, other = (np.load(folder / name)["joints"] for folder in (out, plain))
            assert np.linalg.norm(found - other, axis=-1).mean() < tolerance, name
    left = [path.name for path in out.iterdir() if path.suffix not in (".npz", ".json", ".jsonl")]
    assert not [name for name in left if not name.endswith(".part")]


@pytest.mark.slow
def test_a_killed_batch_is_resumed(tmp_path):
    names = [f"clip{k}" for k in range(30)]
    for seed, name in enumerate(names):
        positions = np.random.default_rng(seed).normal(size=(2, 22, 3))
        save_arrays(tmp_path / f"{name}.npz", {"positions": positions})
    names[3:3] = WAYS
    rows = [{"id": n, "observations": "clip0.npz" if n in WAYS else f"{n}.npz"} for n in names]
    (tmp_path / "clips.jsonl").write_text("\n".join(map(json.dumps, rows)))
    killed_and_resumed(tmp_path, tmp_path / "out", "sum", len(names), kills=3, seconds=0.02)
    assert start(tmp_path, tmp_path / "plain", "sum", 0).wait() == 0
    compared(tmp_path / "out", tmp_path / "plain", names)


@pytest.mark.slow
def test_200_fits_killed_20_times(tmp_path):
    """Of real fits, ten clips bad in ten ways: as issue 13 asks for."""
    names = [f"clip{k}" for k in range(190)]
    body = BodyModel.load()
    motion = load_motion(ROOT / "recon" / "assets" / "demo.npz").motion
    for k, name in enumerate(names):
        short = motion.window(k % 60, k % 60 + 4)
        noise = np.random.default_rng(k).normal(size=(4, 22, 3)) * 0.01
        joints = body.pose(short).joints.double().numpy() + noise
        seen = np.ones((4, 22), np.bool_)
        save_observation(
            tmp_path / f"{name}.npz", PositionsFile("joints3d", joints, seen, JOINTS, short.fps)
        )
    for k, way in enumerate(WAYS):
        names.insert(13 * k, way)
    rows = [{"id": n, "observations": "clip0.npz" if n in WAYS else f"{n}.npz"} for n in names]
    (tmp_path / "clips.jsonl").write_text("\n".join(map(json.dumps, rows)))
    killed_and_resumed(tmp_path, tmp_path / "out", "fit", len(names), kills=20, seconds=0.5)
    assert start(tmp_path, tmp_path / "plain", "fit", 0).wait() == 0
    compared(tmp_path / "out", tmp_path / "plain", names, tolerance=1e-3)

    changed = tmp_path / "clip7.npz"
    data = bytearray(changed.read_bytes())
    data[10] ^= 1  # the date in the archive: another byte, another content
    changed.write_bytes(bytes(data))
    good = [clip for clip in read_manifest(tmp_path / "clips.jsonl") if clip.name not in WAYS]
    out, settings = tmp_path / "out", FitSettings(prior="pose")
    again = {r["id"]: r["status"] for r in fit_all(good, out, settings, 2, out / "log.jsonl")}
    assert [name for name, status in again.items() if status != "skipped"] == ["clip7"]


def test_bad_files_end_as_lines_and_an_exit_code(tmp_path, capsys):
    """A folder of clips in which some are bad in ways that files can be."""
    (tmp_path / "text.npz").write_bytes(b"nothing")
    (tmp_path / "empty").mkdir()
    (tmp_path / "times").mkdir()
    points = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    for k in range(4):
        header = points + "property float z\nend_header\n"
        (tmp_path / "times" / f"{k}.ply").write_text(header + "0 0 1\n")
    (tmp_path / "times" / "times.csv").write_text("0\n1e-320\n2e-320\n1\n")
    (tmp_path / "deep.json").write_text("[" * 200_000)
    paths = ("text.npz", "empty", "times", "deep.json", "none.npz", "clips.jsonl", "/dev/null")
    rows = [{"id": f"bad{k}", "observations": path} for k, path in enumerate(paths)]
    rows.append({"id": "nothing", "observations": []})  # type: ignore[dict-item]
    (tmp_path / "clips.jsonl").write_text("\n".join(map(json.dumps, rows)))
    out = tmp_path / "out"
    assert run(["batch", str(tmp_path / "clips.jsonl"), "--out", str(out)]) == FAILED
    assert json.loads(capsys.readouterr().out)["clips"] == len(rows)
    lines = {line["id"]: line for line in finished(out / "log.jsonl")}
    assert set(lines) == {row["id"] for row in rows}
    assert all(line["error"] for line in lines.values())
    assert not list(out.glob("*.npz"))
