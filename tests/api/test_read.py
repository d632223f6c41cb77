"""`recon.read`: one door for files; a fit of what is in memory opens none."""

import subprocess
import sys

import numpy as np
import pytest

import recon
from recon.formats.observations import load_observation
from tests.filmed import bundled, walk

FIT = """
import sys
import numpy as np
import recon
seen = recon.Joints3D(np.load(sys.argv[1]), np.ones((8, 22), bool), range(22), fps=30.0)
recon.fit(seen)
ours = ("recon.", "priors.", "observations.")
print(*[name for name in sys.modules if name.startswith(ours)])
"""


def test_motions_and_observations_come_by_one_door(tmp_path):
    motion, seen = tmp_path / "motion.npz", tmp_path / "seen.npz"
    simulated = recon.simulate(walk(8), "joints3d")
    simulated.save(seen)
    recon.save_motion(motion, recon.fit(simulated, "pose").file)
    found = recon.read(motion)
    assert not isinstance(found, list)
    assert found.motion.frames == 8
    assert isinstance(recon.read(seen), recon.Joints3D)
    assert len(recon.read([seen, seen])) == 2
    one = recon.read(str(seen), up="z")
    assert np.allclose(one.positions[0], load_observation(seen).positions)
    with pytest.raises(recon.FormatError, match="a motion of recon"):
        recon.read(motion, up="z")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        recon.read(tmp_path / "nowhere.npz")


def test_a_fit_of_joints_loads_no_reader_and_no_code_of_other_sensors(tmp_path):
    """It loaded every reader, conversions of motion capture and the checks of images."""
    np.save(tmp_path / "joints.npy", bundled().pose(walk(8)).joints.numpy())
    ran = subprocess.run(
        [sys.executable, "-c", FIT, str(tmp_path / "joints.npy")],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    loaded = ran.stdout.split()
    rooms = ("recon.reading", "recon.ingest", "recon.people", "recon.view", "recon.simulation")
    images = [f"recon.diagnosis.{name}" for name in ("images", "cameras", "keypoints", "sides")]
    others = (*images, "priors.labels", "priors.anchor", "recon.fitting.cycles")
    sensors = ("observations.depth", "observations.keypoints2d", "observations.markers3d")
    assert "recon.fitting.clip" in loaded
    assert [name for name in loaded if name.startswith((*rooms, *others, *sensors))] == []
