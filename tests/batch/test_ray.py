"""Batches on a Ray cluster: the same log and results, also when a machine of it dies."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from recon.batch.ray_cluster import with_absolute_paths
from recon.cli import BAD_INPUT, run
from recon.core.skeleton import JOINTS
from recon.fitting.settings import FitSettings
from recon.formats.observations import PositionsFile, save_observation
from recon.formats.opening import load_arrays
from recon.formats.replacing import save_arrays
from tests.api.test_front_door import noisy

ROOT = Path(__file__).parents[2]
with_ray = pytest.mark.skipif(
    find_spec("ray") is None, reason="Ray is not installed: pip install 'motion-recon[ray]'"
)


def test_without_ray_it_is_said_how_to_install_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    (tmp_path / "clips.jsonl").write_text('{"id": "a", "observations": "a.npz"}')
    arguments = ["batch", str(tmp_path / "clips.jsonl"), "--out", str(tmp_path / "out")]
    assert run([*arguments, "--ray", "local"]) == BAD_INPUT
    assert "pip install 'motion-recon[ray]'" in capsys.readouterr().err


def test_files_of_settings_are_named_from_the_root(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("own.safetensors").write_bytes(b"")
    settings = FitSettings(camera=Path("camera.toml"), weights="own.safetensors")
    found = with_absolute_paths(settings)
    assert found.camera == tmp_path / "camera.toml"
    assert found.weights == str(tmp_path / "own.safetensors")
    assert with_absolute_paths(FitSettings()) == FitSettings()


def in_cluster(folder: Path, kind: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `tests.batch.ray_jobs` on a manifest; Ray and its processes end with it."""
    environment = {
        **os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "SECONDS_PER_CLIP": "0.3",
    }  # fmt: skip
    return subprocess.run(
        [sys.executable, "-m", "tests.batch.ray_jobs", kind, folder / "clips.jsonl", *arguments],
        env=environment, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


def log_of(out: Path) -> dict[str, dict[str, object]]:
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert len({line["id"] for line in lines}) == len(lines)
    return {line["id"]: line for line in lines}


@with_ray
@pytest.mark.slow
def test_a_machine_that_dies_costs_no_clip(tmp_path):
    """Two nodes, one of them killed after a few clips; what it was working on is done again."""
    names = [f"clip{k}" for k in range(24)]
    for seed, name in enumerate(names):
        positions = np.random.default_rng(seed).normal(size=(2, 22, 3))
        save_arrays(tmp_path / f"{name}.npz", {"positions": positions})
    names += ["be_killed", "refuse"]
    rows = [
        {"id": n, "observations": "clip0.npz" if n in names[-2:] else f"{n}.npz"} for n in names
    ]
    (tmp_path / "clips.jsonl").write_text("\n".join(map(json.dumps, rows)))
    out = tmp_path / "out"
    done = in_cluster(tmp_path, "sums", str(out), "--kill-after", "5")
    assert done.returncode == 0, done.stderr
    assert "killed a node" in done.stdout
    assert "nodes alive: 1" in done.stdout
    log = log_of(out)
    expected = dict.fromkeys(names[:-2], "ok") | {"be_killed": "crashed", "refuse": "bad input"}
    assert {name: line["status"] for name, line in log.items()} == expected
    for name in names[:-2]:
        total = load_arrays(tmp_path / f"{name}.npz")["positions"].sum()
        assert load_arrays(out / f"{name}.npz")["total"] == total
    again = in_cluster(tmp_path, "sums", str(out))
    assert again.stdout.count("skipped") == 24


@with_ray
@pytest.mark.slow
def test_the_command_on_a_cluster_of_this_machine(tmp_path):
    """Fits that end as those in processes of their own, which a run without Ray then skips."""
    for k in range(3):
        file = PositionsFile("joints3d", noisy(8, 0.01 * k), np.ones((8, 22), bool), JOINTS, 30.0)
        save_observation(tmp_path / f"{k}.npz", file)
    rows = [{"id": f"clip{k}", "observations": f"{k}.npz"} for k in range(3)]
    (tmp_path / "clips.jsonl").write_text("\n".join(map(json.dumps, rows)))
    out = tmp_path / "out"
    done = in_cluster(tmp_path, "command", str(out), "--ray", "local", "--processes", "1")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["ok"] == 3
    assert {line["status"] for line in log_of(out).values()} == {"ok"}
    here = in_cluster(tmp_path, "command", str(out))
    assert json.loads(here.stdout)["skipped"] == 3
