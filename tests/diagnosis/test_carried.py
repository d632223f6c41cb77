"""A camera that is declared fixed and moves: told by the way it carries standing feet."""

import math
from dataclasses import replace

import pytest
import torch

from recon.api.pipeline import fit_and_check
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.diagnosis.carried import turned_camera_finding
from recon.diagnosis.movement import belt_velocity
from recon.fitting.methods import FitOptions
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d, orbiting_camera
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, walk

FRAMES = 60
AXIS = (2.0, -1.0)
"""Where a camera stands, metres; far from the person, whom it therefore carries along, too."""


def carried(motion: Motion, degrees: float) -> Motion:
    """The motion in a room that turns evenly about a vertical axis, degrees per second."""
    angle = torch.arange(motion.frames) / motion.fps * math.radians(degrees)
    turn = so3.about_z(angle)
    pelvis = bundled().rest_joints(motion.shape)[0]
    axis = torch.tensor([*AXIS, 0.0])
    place = (turn @ (motion.translation + pelvis - axis)[..., None])[..., 0] + axis - pelvis
    rotations = motion.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    return motion.replace(translation=place, rotations=rotations)


@pytest.mark.parametrize("degrees", [-25.0, 15.0])
def test_feet_that_all_turn_at_one_rate(degrees: float) -> None:
    """A phone that was carried around a person was believed to stand, and nothing was said."""
    found = turned_camera_finding("phone", carried(walk(FRAMES), degrees), bundled())
    assert found is not None
    assert found.value is not None
    assert found.code == "camera moves"
    assert found.value == pytest.approx(degrees, abs=3)
    assert "T_camera_world" in found.message
    assert f"{2 * abs(found.value):.0f} degrees in this clip" in found.message


def test_a_walk_before_a_fixed_camera() -> None:
    assert turned_camera_finding("phone", walk(FRAMES), bundled()) is None


def test_somebody_who_pirouettes_is_not_a_camera() -> None:
    """Nobody pans a camera by half a turn in a second; people turn that fast on one foot."""
    assert turned_camera_finding("phone", carried(walk(FRAMES), 180.0), bundled()) is None


def test_a_treadmill_carries_feet_but_turns_none() -> None:
    motion = walk(FRAMES)
    drift = (motion.translation[-1] - motion.translation[0]) / (FRAMES - 1)
    drift[2] = 0
    back = torch.arange(FRAMES)[:, None] * drift
    on_belt = motion.replace(translation=motion.translation - back)
    assert belt_velocity(on_belt, bundled()) is not None
    assert turned_camera_finding("phone", on_belt, bundled()) is None


def test_feet_that_were_not_seen_tell_nothing() -> None:
    seen = torch.ones(FRAMES, len(JOINTS), dtype=torch.bool)
    motion = carried(walk(FRAMES), -25.0)
    assert turned_camera_finding("phone", motion, bundled(), seen) is not None
    seen[:, [JOINTS.index("left_foot"), JOINTS.index("right_foot")]] = False
    assert turned_camera_finding("phone", motion, bundled(), seen) is None


def test_a_phone_that_is_carried_around_a_person() -> None:
    """The fit agrees with the image to the noise, so no residual tells of the camera."""
    motion = walk(FRAMES).resample(15.0)
    middle = bundled().pose(motion).joints.flatten(0, 1).mean(0)
    stands = cameras(motion, first=0.7)[0]
    camera = orbiting_camera(stands, middle, motion.frames, math.radians(40.0))
    file = keypoints2d(motion, bundled(), camera, Corruption(noise=3.0), 0)
    unknown = replace(file.camera, T_camera_world=None)
    seen = keypoints_of(replace(file, camera=unknown), bundled())
    examined = fit_and_check([seen], ["phone"], FitOptions(prior="pose"), bundled())
    assert [found.code for found in examined.warnings] == ["camera moves"]
