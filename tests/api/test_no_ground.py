"""`recon.fit(..., ground=None)`: water, ropes, stairs; nothing is judged by heights."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import tyro

import recon
from priors.pose.prior import PosePrior
from recon.core.errors import ReconError
from recon.core.skeleton import JOINTS
from recon.fitting.ground import LEVEL_CAMERA, camera_above
from recon.fitting.methods import FitOptions
from recon.fitting.settings import FitSettings
from recon.formats.observations import PositionsFile, save_observation
from recon.method.priors import Traits
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS
from tests.filmed import bundled, cameras, view, walk


class Quick:
    """Four iterations of every stage of the pose prior."""

    traits = Traits(knows_gravity=False)

    def stages(self, data: tuple[Term, ...]):
        return tuple(replace(s, minimiser=LBFGS(4)) for s in PosePrior.load().stages(data))


def lifted(height: float) -> recon.Joints3D:
    joints = bundled().pose(walk(12)).joints + torch.tensor([0.0, 0.0, height])
    return recon.Joints3D(joints, np.ones((12, 22), bool), range(22), fps=30.0)


def test_heights_mean_nothing(tmp_path):
    on_floor, on_wall = (recon.fit(lifted(z), Quick(), ground=None) for z in (0.0, 3.0))
    moved = on_wall.joints - on_floor.joints
    torch.testing.assert_close(
        moved, torch.tensor([0.0, 0.0, 3.0]).expand_as(moved), atol=2e-3, rtol=0.0
    )
    assert on_wall.ground is None
    assert not on_wall.contacts.any()
    found = (*on_wall.warnings, *on_wall.repairs, *on_wall.diagnosis)
    assert found == ()
    assert on_wall.report()["grounded"] is False
    assert on_wall.report()["settings"]["ground"] is None
    on_wall.save(tmp_path / "wall.npz")
    file = recon.load_motion(tmp_path / "wall.npz")
    assert file.ground is None
    assert file.contacts is None
    assert recon.evaluate(tmp_path / "wall.npz", walk(12))["slip_speed"] >= 0


def test_with_a_ground_the_same_points_are_said_to_float():
    """The finding that must not come without a ground does come with one."""
    codes = {one.code for one in recon.fit(lifted(3.0), Quick()).repairs}
    assert "floor" in codes


@pytest.mark.parametrize("prior", ["humor", "anchor"])
def test_priors_that_need_the_ground_are_refused(prior):
    with pytest.raises(ReconError, match=f"'{prior}' needs the ground.*fit with the prior 'pose'"):
        recon.fit(lifted(0.0), prior, ground=None)


def test_a_prior_without_the_trait_is_taken_to_need_the_ground():
    class Plain:
        stages = Quick.stages

    with pytest.raises(ReconError, match=r"'Plain' needs the ground.*knows_gravity is False"):
        FitOptions(Plain(), grounded=False)
    with pytest.raises(ReconError, match="expected physics=0, got 1"):
        recon.fit(lifted(0.0), "pose", ground=None, physics=1.0)


def test_a_camera_without_a_pose_is_as_if_held_level():
    seen = view(walk(12), cameras(walk(12))[0])
    own = seen.camera.replace(T_camera_world=torch.eye(4)[None, None])
    result = recon.fit(seen.replace(camera=own), Quick(), ground=None, repair=False)
    expected = torch.from_numpy(np.asarray(camera_above(LEVEL_CAMERA))).float()
    torch.testing.assert_close(result.T_world_camera, expected)
    assert result.ground is None


def test_the_command_line_says_none(tmp_path):
    settings = tyro.cli(FitSettings, args=["--ground", "none", "--prior", "pose"])
    assert settings.ground == "none"
    plane = tyro.cli(FitSettings, args=["--ground", "0", "-1", "0", "-1.2"]).ground
    assert plane == (0.0, -1.0, 0.0, -1.2)
    joints = bundled().pose(walk(6)).joints.double().numpy() + 2.0
    file = PositionsFile("joints3d", joints, np.ones((6, 22), bool), JOINTS, 30.0)
    save_observation(tmp_path / "seen.npz", file)
    assert recon.fit(tmp_path / "seen.npz", **settings.arguments()).ground is None
