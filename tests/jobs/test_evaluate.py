"""Results of cameras that do not know where they stand, carried into the true world."""

import json
import math
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from recon.api.evaluate import evaluate
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import MotionFile
from recon.formats.motions import load_motion, save_motion
from recon.formats.observations import KeypointsFile, load_observation
from recon.simulation.points import Corruption
from tests.verbs import simulate_file

TILT, LIFT = 0.05, 0.07
"""Radians and metres by which the ground is wrong."""


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = load_motion(path).motion.window(30, 38)
    target = tmp_path_factory.mktemp("clip") / "truth.npz"
    save_motion(target, motion)
    return target


def another_world() -> torch.Tensor:
    """Maps the true world to one that is turned, moved, tilted by `TILT` and lifted."""
    turn = so3.exp(torch.tensor([0.0, 0.0, 1.3]).double())
    tilt = so3.exp(torch.tensor([TILT, 0.0, 0.0]).double())
    T = torch.eye(4).double()
    T[:3, :3], T[:3, 3] = tilt @ turn, torch.tensor([2.0, -1.0, LIFT]).double()
    return T


@pytest.fixture
def found(clip, tmp_path) -> tuple[Path, Path, torch.Tensor]:
    """A result that is the truth in another world, its observation, the camera found."""
    seen, result = tmp_path / "seen.npz", tmp_path / "result.npz"
    hidden = Corruption(hide_below=0.5)
    simulate_file(clip, seen, "keypoints2d", hidden, seed=0, unknown_ground=True)
    file = load_observation(seen)
    assert isinstance(file, KeypointsFile)
    truth = load_motion(clip, torch.float64).motion
    T, pelvis = another_world(), BodyModel.load().rest_joints(truth.shape.float())[0].double()
    camera = T @ torch.from_numpy(file.truth_T_world_camera)
    save_motion(result, MotionFile(truth.carried(T, pelvis), T_world_camera=camera[None]))
    return result, seen, camera


def test_an_observation_beside_true_joints_is_refused(clip, found):
    """It was ignored without a word, even where there was no such file."""
    joints = BodyModel.load().pose(load_motion(clip).motion).joints
    with pytest.raises(ValueError, match=r"joints alone .* give the true motion"):
        evaluate(clip, joints, observation=found[1])
    assert evaluate(clip, joints)["joints_all"] == pytest.approx(0.0, abs=1e-6)


def test_a_true_motion_on_a_wrong_ground(clip, found, tmp_path):
    result, seen, camera = found
    metrics = evaluate(result, clip, observation=seen)
    metrics.save(tmp_path / "m.json")
    assert metrics.items() <= json.loads((tmp_path / "m.json").read_text()).items()
    for name in ("joints_all", "joints_hidden", "joints_visible", "vertices"):
        assert metrics[name] == pytest.approx(0.0, abs=1e-4)  # metres
    assert metrics["ground_normal"] == pytest.approx(TILT, abs=1e-4)
    file = load_observation(seen)
    assert isinstance(file, KeypointsFile)
    assert file.truth_T_world_camera is not None
    height = abs(float(camera[2, 3]) - file.truth_T_world_camera[2, 3])
    assert height > 0.02
    assert metrics["ground_height"] == pytest.approx(height, abs=1e-5)  # metres


def test_how_it_stands_is_judged_on_the_ground_that_was_found(clip, found):
    result, seen, _ = found
    blind, seeing = (
        evaluate(result, clip),
        evaluate(result, clip, observation=seen),
    )
    for name in ("penetration_freq", "penetration_dist", "sole_penetration_dist", "slip_speed"):
        assert seeing[name] == pytest.approx(blind[name])
    assert blind["joints_all"] > 0.5  # metres: another world
    assert blind["ground_normal"] is blind["ground_height"] is None
    assert blind.keys() == seeing.keys()


def test_without_either_camera_nothing_is_carried(clip, found, tmp_path):
    result, seen, _ = found
    file = load_motion(result)
    save_motion(tmp_path / "bare.npz", MotionFile(file.motion))
    assert evaluate(tmp_path / "bare.npz", clip, observation=seen)["ground_normal"] is None
    with np.load(seen) as arrays:
        kept = {k: arrays[k] for k in arrays.files if k != "truth_T_world_camera"}
    np.savez(tmp_path / "plain.npz", **kept)
    metrics = evaluate(result, clip, observation=tmp_path / "plain.npz")
    assert metrics["ground_height"] is None
    assert metrics["joints_hidden"] is not None  # visibility needs no pose


def test_points_of_a_depth_sensor_tell_the_same(clip, tmp_path):
    seen = tmp_path / "depth.npz"
    simulate_file(clip, seen, "depth", Corruption(), seed=0, unknown_ground=True)
    truth = load_motion(clip)
    camera = torch.from_numpy(load_observation(seen).truth_T_world_camera)  # type: ignore[union-attr]
    save_motion(tmp_path / "r.npz", MotionFile(truth.motion, T_world_camera=camera[None]))
    metrics = evaluate(tmp_path / "r.npz", clip, observation=seen)
    assert metrics["ground_normal"] == pytest.approx(0.0, abs=1e-5)
    assert metrics["joints_all"] == pytest.approx(0.0, abs=1e-5)


def test_many_found_poses_are_refused(clip, found, tmp_path):
    result, seen, camera = found
    file = load_motion(result)
    poses = camera.expand(file.motion.frames, 4, 4)
    save_motion(tmp_path / "many.npz", MotionFile(file.motion, T_world_camera=poses))
    with pytest.raises(ValueError, match="expected one"):
        evaluate(tmp_path / "many.npz", clip, observation=seen)
    assert math.isfinite(evaluate(result, clip, observation=seen)["joints_all"] or math.nan)
