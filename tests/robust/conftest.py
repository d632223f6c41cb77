"""Small inputs that the attacks share."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import recon
from scripts.frozen.inputs import write_c3d
from tests.robust.doors import DEMO, DONE, command


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of whole files: a motion, observations, and a recording in three formats."""
    folder = tmp_path_factory.mktemp("whole")
    with np.load(DEMO) as demo:
        walk = {key: demo[key] for key in demo.files}
    for name, stop in (("motion", 56), ("short", 30)):
        cut = {k: v[20:stop] if v.shape[:1] == (120,) else v for k, v in walk.items()}
        np.savez(folder / f"{name}.npz", **cut)
    frames = (20, 32)
    for kind in ("joints3d", "keypoints2d", "depth", "scans"):
        options = {"points": 60} if kind in ("depth", "scans") else {}
        name = "scans" if kind == "scans" else f"{kind}.npz"
        seen = recon.simulate(DEMO, kind, noise=0.01, frames=frames, seed=1, **options)
        seen.save(folder / name)
    for name, option in (("motion", "--trc"), ("short", "--bvh")):
        out = folder / f"walk.{option[2:]}"
        words = ("--markers", "pig") if option == "--trc" else ()
        code, _, said = command("export", folder / f"{name}.npz", option, out, *words)
        assert code == DONE, said
    write_c3d(folder / "walk.c3d", folder / "walk.trc")
    return folder


@pytest.fixture
def seen(whole: Path, tmp_path: Path) -> Path:
    """An observation file of 3D joints in a folder of its own."""
    return Path(shutil.copy(whole / "joints3d.npz", tmp_path / "seen.npz"))
