"""Motions on another mesh: a stand-in for a SMPL file, which nobody may give us."""

from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from recon import cli
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.motion import Motion
from recon.core.nearest import closest_points
from recon.core.skeleton import JOINTS
from recon.ingest.transfer import MotionOnOtherBody, transfer
from scripts.build_stand_in import build

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("body") / "STAND_IN_FEMALE.npz"
    np.savez(path, **build(bodies=40))
    return path


@pytest.fixture(scope="module")
def stand_in(file) -> BodyModel:
    return BodyModel.load(file)


@pytest.fixture(scope="module")
def walk() -> Motion:
    """Eight frames of a walk, a sixth of a second apart."""
    return load_motion_of(DEMO, BodyModel.load()).motion.resample(6.0).window(4, 12)


@pytest.fixture(scope="module")
def found(walk, stand_in) -> MotionOnOtherBody:
    return transfer(walk, BodyModel.load(), stand_in)


def test_the_stand_in_is_another_body(stand_in):
    ours = BodyModel.load()
    assert len(stand_in.template) != len(ours.template)
    assert stand_in.shape_size == 10
    assert stand_in.pose_directions is not None
    rest = ours.rest_joints(torch.zeros(ours.shape_size))
    apart = (stand_in.rest_joints(torch.zeros(10)) - rest).norm(dim=-1)
    assert float(apart[JOINTS.index("left_wrist")]) > 0.05


def test_our_motion_lies_on_our_surface(found):
    assert np.median(found.distances) < 0.005
    assert np.quantile(found.distances, 0.95) < 0.015


def test_betas_are_those_of_the_file(found, walk, stand_in):
    assert found.motion.shape.shape == (10,)
    assert found.motion.shape.abs().max() > 0.1
    # our own coefficients, taken for theirs, are another person
    wrong = stand_in.rest_vertices(walk.shape[:10])
    right = stand_in.rest_vertices(found.motion.shape)
    assert float((wrong - right).norm(dim=-1).median()) > 0.01


def test_time_stays(found, walk):
    assert found.motion.frames == walk.frames
    assert found.motion.fps == walk.fps
    assert found.motion.start_time == walk.start_time


@pytest.mark.slow
def test_their_motions_there_and_back(found, stand_in):
    shape = torch.tensor(np.random.default_rng(1).normal(0, 1, 10)).float()
    theirs = found.motion.replace(shape=shape)
    ours = transfer(theirs, stand_in, BodyModel.load())
    assert np.median(ours.distances) < 0.005
    back = transfer(ours.motion, BodyModel.load(), stand_in).motion
    before, after = stand_in.pose(theirs), stand_in.pose(back)
    assert float((before.vertices - after.vertices).norm(dim=-1).median()) < 0.005
    assert float((before.joints - after.joints).norm(dim=-1).median()) < 0.005


def test_the_command_writes_a_file_of_amass(tmp_path, file, stand_in, walk):
    recon.save_motion(tmp_path / "two.npz", walk.window(0, 2))
    out = tmp_path / "theirs.npz"
    line = ["export", str(tmp_path / "two.npz"), "--smpl", str(out), "--onto", str(file)]
    assert cli.run(line) == cli.OK
    with np.load(out) as arrays:
        assert arrays["poses"].shape == (2, 72)
        assert arrays["betas"].shape == (10,)
        assert str(arrays["gender"]) == "female"
        assert np.array_equal(arrays["poses"][:, :3], arrays["root_orient"])
    # our own body refuses it, theirs takes it
    with pytest.raises(recon.ReconError, match="made with the body"):
        load_motion_of(out, BodyModel.load())
    assert load_motion_of(out, stand_in).motion.frames == 2


def test_one_option_without_the_other_is_refused(tmp_path, capsys):
    out = tmp_path / "theirs.npz"
    assert cli.run(["export", str(DEMO), "--smpl", str(out)]) == cli.BAD_INPUT
    assert "--smpl and --onto go together" in capsys.readouterr().err


def test_a_batch_is_refused(walk, stand_in):
    with pytest.raises(recon.ReconError, match="one clip"):
        transfer(walk[None], BodyModel.load(), stand_in)


def test_the_nearest_point_of_a_triangle():
    """Above the inside, beyond an edge, and beyond a corner."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = np.array([[0.2, 0.3, 0.5], [0.8, 0.8, 0.1], [-1.0, -1.0, 0.0]])
    found = closest_points(points, corners, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(found.places, [[0.2, 0.3, 0], [0.5, 0.5, 0], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(found.shares.sum(-1), 1)
