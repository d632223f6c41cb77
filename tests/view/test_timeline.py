"""Files for the Rerun viewer, read back by its own reader."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from recon import cli
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.motion import MotionFile
from recon.core.skeleton import JOINTS
from recon.formats.motions import save_motion
from recon.formats.observations import PositionsFile, save_observation
from recon.view.files import write_rrd

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"
FRAMES = 6


@pytest.fixture
def files(tmp_path) -> tuple[Path, Path]:
    """A motion with contacts and standard deviations, and its joints, some of them hidden."""
    body = BodyModel.load()
    motion = load_motion_of(DEMO, body).motion.window(10, 10 + FRAMES)
    joints = body.pose(motion).joints
    file = MotionFile(
        motion, body=body.name, checksum=body.checksum, joints=joints,
        contacts=torch.ones(FRAMES, 22), joint_std=torch.full((FRAMES, 22), 0.02),
    )  # fmt: skip
    save_motion(tmp_path / "walk.npz", file)
    seen = np.ones((FRAMES, 22), dtype=bool)
    seen[:, 20:] = False
    positions = joints.double().numpy() * seen[..., None]
    observation = PositionsFile("joints3d", positions, seen, JOINTS, 30.0, motion.start_time)
    save_observation(tmp_path / "seen.npz", observation)
    return tmp_path / "walk.npz", tmp_path / "seen.npz"


def test_everything_is_on_the_timelines(files, tmp_path):
    reader = pytest.importorskip("rerun.chunk")
    motion, seen = files
    out = tmp_path / "walk.rrd"
    assert cli.run(["view", str(motion), "--obs", str(seen), "--rrd", str(out)]) == cli.OK
    rows: Counter[str] = Counter()
    for chunk in reader.RrdReader(str(out)).stream():
        if chunk.is_static:
            continue
        assert {"time", "frame"} <= set(chunk.timeline_names)
        rows[chunk.entity_path] += chunk.num_rows
    layers = ("body", "joints", "bones", "contacts", "standard deviation")
    named = {path.replace("\\", ""): count for path, count in rows.items()}
    expected = {f"/world/walk/{layer}" for layer in layers}
    expected |= {"/world/points/seen", "/world/points/hidden"}
    assert named == dict.fromkeys(expected, FRAMES)
    assert out.with_name("walk.rrd.json").is_file()


def test_without_rerun_it_says_what_to_install(tmp_path, monkeypatch):
    from recon.view.files import show_of_files

    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(recon.ReconError, match=r"motion-recon\[rerun\]"):
        write_rrd(tmp_path / "walk.rrd", show_of_files(DEMO))
    assert list(tmp_path.iterdir()) == []
