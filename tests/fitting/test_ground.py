"""The ground from how people stand, in recordings whose frame is not the world."""

import math

import pytest
import torch

from recon.body.soles import ground_heights
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.rotations import transform
from recon.fitting.clip import fit_clip
from recon.fitting.ground import (
    ground_by_feet,
    ground_by_posture,
    mean_up,
    point_below_pelvis,
)
from recon.fitting.methods import FitOptions
from recon.simulation.points import Corruption, joints3d
from tests.filmed import bundled, turned, walk

pytestmark = pytest.mark.numerics

UP = torch.tensor([0.0, 0.0, 1.0])


def carried(motion: Motion, T: torch.Tensor) -> Motion:
    return motion.carried(T, bundled().rest_joints(motion.shape)[0])


def recording(tilt: float, about: float, height: float) -> tuple[Motion, torch.Tensor]:
    """A walk in a frame that leans by `tilt` radians; and T_recording_world."""
    axis = torch.tensor([math.cos(about), math.sin(about), 0.0])
    T = torch.eye(4)
    T[:3, :3] = so3.exp(tilt * axis)
    T[:3, 3] = torch.tensor([0.5, -1.0, height])
    return carried(walk(60), T).map(lambda t: t[None]), T


@pytest.mark.parametrize("tilt", [0.0, 5.0, 20.0])
@pytest.mark.parametrize("about", [0.0, 2.0])
def test_a_leaning_frame_is_found(tilt, about):
    motion, T = recording(math.radians(tilt), about, 0.7)
    ground = ground_by_posture(motion, bundled())
    there = ground.T_world_recording[0] @ T
    angle = math.degrees(torch.acos((there[:3, :3] @ UP)[2].clamp(max=1)))
    assert angle < 6  # degrees; this walker leans forward by 5.5 in the mean
    level = ground_by_posture(walk(60).map(lambda t: t[None]), bundled()).T_world_recording[0]
    between = there[:3, :3] @ level[:3, :3].mT
    assert math.degrees(so3.log(between)[:2].norm()) < 0.1  # the frame adds nothing to it
    below = transform(there, walk(60).translation.mean(0, keepdim=True) * (1 - UP))
    assert abs(float(below[0, 2])) < 0.05  # metres


def test_a_level_frame_needs_a_height_alone():
    lifted = walk().replace(translation=walk().translation + 0.4 * UP).map(lambda t: t[None])
    ground = ground_by_feet(lifted, bundled())
    assert (ground.tilt == 0).all()
    assert float(ground.lift[0]) == pytest.approx(-0.4, abs=0.02)
    assert float(ground_heights(lifted, bundled())[0]) == pytest.approx(0.4, abs=0.02)
    below = point_below_pelvis(lifted, bundled())[0]
    assert below[2] == 0
    assert (below - lifted.translation.mean(1)[0]).norm(dim=-1) > 0.1


def test_up_does_not_depend_on_where_people_look():
    ways = [mean_up(turned(walk(), a).map(lambda t: t[None]), bundled()) for a in (0.0, 2.0)]
    torch.testing.assert_close(ways[0][..., 2], ways[1][..., 2])
    assert float(ways[0][0, 2]) > math.cos(math.radians(5))


def test_padding_says_nothing():
    """A batch's shorter clip repeats its last frame; that must not weigh."""
    motion, _ = recording(0.2, 1.0, 0.3)
    longer = torch.cat((motion.valid, torch.zeros(1, 40, dtype=torch.bool)), 1)
    padded = motion.replace(
        translation=torch.cat(
            (motion.translation, motion.translation[:, -1:] + 5.0 + torch.zeros(1, 40, 3)), 1
        ),
        rotations=torch.cat(
            (motion.rotations, motion.rotations[:, -1:].expand(1, 40, 22, 3, 3)), 1
        ),
        valid=longer,
    )
    here, there = (
        ground_by_posture(motion, bundled()),
        ground_by_posture(padded, bundled()),
    )
    torch.testing.assert_close(here.tilt, there.tilt)
    torch.testing.assert_close(here.lift, there.lift)
    torch.testing.assert_close(here.pivot, there.pivot)


def test_clips_of_a_batch_have_grounds_of_their_own():
    first, _ = recording(0.3, 0.0, 0.7)
    second, _ = recording(-0.1, 1.0, -0.2)
    both = ground_by_posture(
        first.replace(
            translation=torch.cat((first.translation, second.translation)),
            rotations=torch.cat((first.rotations, second.rotations)),
            shape=first.shape.expand(2, -1),
            valid=first.valid.expand(2, -1),
        ),
        bundled(),
    )
    alone = ground_by_posture(second, bundled())
    torch.testing.assert_close(both.T_world_recording[1], alone.T_world_recording[0])


def test_a_height_that_is_not_known_is_found_under_humor():
    """Stages by second order ended in an error, as the height of the ground has no axis."""
    seen = joints3d(walk(20), bundled(), Corruption(noise=0.01), 0).replace(ground_known=False)
    raised = seen.replace(positions=seen.positions + torch.tensor([0.0, 0.0, 0.3]))
    found = fit_clip([raised[None]], FitOptions(), bundled())
    assert float(found.T_world_recording[0, 2, 3]) == pytest.approx(-0.3, abs=0.06)  # metres
