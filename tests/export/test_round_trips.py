"""Formats that are written and read: frames, rate, clock, unit, axes and frame survive."""

from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from recon.body.angles import isb_angles
from recon.core.errors import ReconError
from recon.core.motion import MotionFile
from recon.core.skeleton import JOINTS
from recon.export.bvh import skeleton_of, write_bvh
from recon.export.motion import export_file
from recon.export.tables import recorded_markers
from recon.formats.motions import load_motion, save_motion
from recon.mocap.bvh import read_bvh
from recon.mocap.marker_tables import read_trc, write_trc
from tests.export.test_opensim_files import make_motion

FRAMES = 100


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
@pytest.mark.parametrize("up", ["x", "y", "z"])
@pytest.mark.parametrize("fps", [30.0, 59.94, 250.0])
def test_trc(body, tmp_path, unit, up, fps):
    motion = make_motion(body, FRAMES, 31.5)
    motion = motion.replace(fps=fps)
    truth = recorded_markers(motion, body, "opencap", "clip")
    write_trc(tmp_path / "clip.trc", truth, unit=unit, up=up)
    back = read_trc(tmp_path / "clip.trc")
    assert back.frames == FRAMES
    assert back.fps == pytest.approx(fps, rel=1e-4)
    assert back.start_time == 31.5
    assert back.marker_names == truth.marker_names
    assert any(f"unit {unit}: stated" in decision for decision in back.decisions)
    # the same place and heading in the room, whatever the axes of the file
    assert np.abs(back.positions - truth.positions).max() < 1e-6  # m


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
@pytest.mark.parametrize("fps", [30.0, 120.0])
def test_bvh(body, tmp_path, unit, fps):
    motion = make_motion(body, FRAMES)
    motion = motion.replace(fps=fps)
    truth = skeleton_of(motion, body, "clip")
    write_bvh(tmp_path / "clip.bvh", truth, unit=unit)
    back = read_bvh(tmp_path / "clip.bvh")
    assert back.frames == FRAMES
    assert back.fps == fps
    names = [back.joint(name) for name in JOINTS]
    assert np.abs(back.positions[:, names] - truth.positions[:, :22]).max() < 1e-6  # m
    assert np.abs(back.orientations[:, names] - truth.orientations[:, :22]).max() < 1e-6


@pytest.mark.parametrize("name", ["glb=a.gltf", "glb=a.vrm", "trc=a.csv", "bvh=a.txt"])
def test_endings_of_other_formats_are_refused(tmp_path, name):
    """The file was written in the option's format, whatever its name said."""
    option, _, file = name.partition("=")
    with pytest.raises(ReconError, match=f"--{option} .*expected a file that ends in "):
        export_file(tmp_path / "motion.npz", **{option: tmp_path / file})


def test_motion_files(body, tmp_path: Path):
    motion = make_motion(body, FRAMES, 31.5)
    save_motion(tmp_path / "clip.npz", MotionFile(motion, body.name, body.checksum))
    back = load_motion(tmp_path / "clip.npz", torch.float64).motion
    assert (back.frames, back.fps, back.start_time) == (FRAMES, 120.0, 31.5)
    assert float((back.rotations - motion.rotations).abs().max()) < 1e-9
    assert torch.equal(back.translation, motion.translation)


def test_angles_in_python_are_those_of_the_file(body, tmp_path):
    motion = make_motion(body, FRAMES, 31.5)
    save_motion(tmp_path / "clip.npz", MotionFile(motion, body.name, body.checksum))
    for given in (motion.map(lambda t: t.float() if t.is_floating_point() else t),
                  tmp_path / "clip.npz"):  # fmt: skip
        found = recon.joint_angles(given)
        assert found.times[0] == 31.5
        assert len(found.times) == FRAMES
        truth = isb_angles(motion, body)
        for name, values in found.degrees.items():
            assert np.abs(values - truth[name]).max() < 1e-2, name  # degrees, float32
    model = recon.joint_angles(motion, convention="gait2392", body=body)
    assert set(model.metres) == {"pelvis_tx", "pelvis_ty", "pelvis_tz"}
    assert "pelvis_tx" not in model.degrees
    assert len(repr(model).splitlines()) <= 10
