"""USD: what usd-core makes of the file is the body that was written."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch

from recon import cli
from recon.body.hands import RELAXED, HandModel, pose_fingers
from recon.core.motion import MotionFile
from recon.core.skeleton import JOINTS
from recon.export.usd import joint_paths, write_usd
from recon.formats.motions import save_motion
from tests.export.test_opensim_files import make_motion
from tests.hands.made import hands_of_angles


@pytest.fixture
def written(body, tmp_path):
    pytest.importorskip("pxr.UsdSkel")
    motion = make_motion(body, 7)
    write_usd(tmp_path / "m.usdc", motion, body)
    assert list(tmp_path.iterdir()) == [tmp_path / "m.usdc"]
    stage = import_module("pxr.Usd").Stage.Open(str(tmp_path / "m.usdc"))
    return stage, motion


def skinned(stage, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Joints and vertices as UsdSkel computes them at a frame, in the world."""
    skel = import_module("pxr.UsdSkel")
    cache = skel.Cache()
    root = skel.Root(stage.GetPrimAtPath("/person"))
    proxy = import_module("pxr.Usd").PrimDefaultPredicate
    cache.Populate(root, proxy)
    query = cache.GetSkelQuery(skel.Skeleton(stage.GetPrimAtPath("/person/skeleton")))
    joints = np.array(query.ComputeJointSkelTransforms(frame))[:, 3, :3]
    mesh = stage.GetPrimAtPath("/person/body")
    points = import_module("pxr.UsdGeom").Mesh(mesh).GetPointsAttr().Get()
    moved = import_module("pxr.Vt").Vec3fArray(points)
    skin = cache.GetSkinningQuery(mesh)
    assert skin.ComputeSkinnedPoints(query.ComputeSkinningTransforms(frame), moved, frame)
    return joints, np.array(moved)


def test_the_library_skins_the_file_to_the_body(written, body):
    stage, motion = written
    posed = body.pose(motion)
    for frame in range(motion.frames):
        joints, vertices = skinned(stage, frame)
        assert np.abs(joints - posed.joints[frame].numpy()).max() < 1e-5  # m, float32
        assert np.abs(vertices - posed.vertices[frame].numpy()).max() < 1e-4  # m


def test_unit_axis_rate_and_clock_are_said(written):
    stage, motion = written
    geometry = import_module("pxr.UsdGeom")
    assert geometry.GetStageUpAxis(stage) == geometry.Tokens.z
    assert geometry.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetTimeCodesPerSecond() == motion.fps
    assert stage.GetEndTimeCode() - stage.GetStartTimeCode() + 1 == motion.frames
    assert stage.GetRootLayer().customLayerData["start_time"] == motion.start_time
    assert stage.GetDefaultPrim().GetPath() == "/person"


def test_the_validators_of_the_format_find_nothing(written):
    stage, _ = written
    validation = pytest.importorskip("pxr.UsdValidation")
    every = validation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(every) > 10
    found = validation.ValidationContext(every).Validate(stage)
    assert [one.GetMessage() for one in found] == []


def test_joints_are_named_by_the_way_to_them():
    paths = joint_paths()
    assert paths[0] == "pelvis"
    assert paths[JOINTS.index("left_foot")] == "pelvis/left_hip/left_knee/left_ankle/left_foot"
    assert len(set(paths)) == 22


def test_without_the_library_the_message_says_what_to_install(
    body, tmp_path: Path, monkeypatch, capsys
):
    save_motion(tmp_path / "clip.npz", MotionFile(make_motion(body), body.name, body.checksum))
    monkeypatch.setitem(sys.modules, "pxr.UsdSkel", None)
    line = ["export", str(tmp_path / "clip.npz"), "--usd", str(tmp_path / "m.usdc")]
    assert cli.run(line) == cli.BAD_INPUT
    assert "pip install 'motion-recon[usd]'" in capsys.readouterr().err
    assert not (tmp_path / "m.usdc").exists()
    line[-1] = str(tmp_path / "m.obj")
    assert cli.run(line) == cli.BAD_INPUT
    assert ".usdc" in capsys.readouterr().err


def test_fingers_are_where_the_library_puts_them(body, tmp_path):
    pytest.importorskip("pxr.UsdSkel")
    motion = make_motion(body, 3)
    angles = RELAXED + torch.linspace(0, 0.3, 3, dtype=torch.float64)[:, None, None]
    hands = hands_of_angles(angles.expand(3, 2, 22), HandModel.of(body, motion.shape))
    motion = motion.replace(hands=hands.to(dtype=motion.translation.dtype))
    write_usd(tmp_path / "m.usda", motion, body, "unreal")
    stage = import_module("pxr.Usd").Stage.Open(str(tmp_path / "m.usda"))
    fingers, _ = pose_fingers(motion, body)
    for frame in range(3):
        joints, _ = skinned(stage, frame)
        assert joints.shape == (52, 3)
        assert np.abs(joints[22:] - fingers[frame, :30].numpy()).max() < 1e-5  # m, float32
    text = (tmp_path / "m.usda").read_text()
    assert "hand_l/index_01_l/index_02_l/index_03_l" in text
