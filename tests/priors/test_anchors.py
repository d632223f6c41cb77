import math

import pytest
import torch

from priors.anchor.frames import ANCHORS, POSE_NUMBERS, Anchors, rest_pelvis
from recon.body.model import BodyModel
from recon.core import rotations as so3
from tests.laws import a_motion
from tests.walking import a_walk

pytestmark = pytest.mark.numerics

BODY = BodyModel.load()
DOUBLE = BODY.to(dtype=torch.float64)


def _rigid(yaw, tilt=0.0, shift=(0.3, -1.2, 0.0)):
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3] = so3.about_z(torch.tensor(yaw, dtype=torch.float64)) @ so3.exp(
        torch.tensor([tilt, 0.4 * tilt, 0.0], dtype=torch.float64)
    )
    T[:3, 3] = torch.tensor(shift)
    return T


def test_the_rows_of_the_rest_pose_are_zero():
    motion = a_walk(BODY).window(0, 2)
    still = motion.replace(rotations=torch.eye(3).expand_as(motion.rotations))
    rows = Anchors.of(still).pack()
    assert rows.shape == (ANCHORS, 124)
    assert float(rows[:, :POSE_NUMBERS].abs().max()) == 0.0


def test_packing_is_exact_and_durations_come_back():
    motion = a_motion(DOUBLE, clips=2, frames=40, fps=50.0)
    anchors = Anchors.of(motion)
    back = Anchors.unpack(anchors.pack())
    for path, tensor in anchors.tensors().items():
        assert torch.allclose(back.tensors()[path], tensor, atol=1e-12), path
    assert torch.allclose(back.duration, torch.tensor(39 / 50, dtype=torch.float64), atol=1e-12)


def test_anchors_replay_the_motion_between_its_frames():
    motion = a_walk(DOUBLE.to(dtype=torch.float32), seconds=1.3)
    anchors = Anchors.of(motion)
    replayed = anchors.motion(motion.shape, (ANCHORS - 1) / float(anchors.duration))
    times = motion.times.clamp(max=float(replayed.times[-1]))
    found = BODY.pose(replayed.at(times, motion.fps))
    expected = BODY.pose(motion)
    assert float((found.joints[:, :10] - expected.joints[:, :10]).norm(dim=-1).max()) < 2e-3


def test_no_rigid_motion_that_it_takes_away_changes_aligned_cycles():
    motion = a_motion(DOUBLE, clips=1, frames=30)
    pelvis = rest_pelvis(DOUBLE, motion.shape)
    moved = motion.carried(_rigid(1.1)[None], pelvis)
    one, _ = Anchors.of(motion).aligned(pelvis)
    other, _ = Anchors.of(moved).aligned(pelvis)
    assert torch.allclose(one.pack(), other.pack(), atol=1e-9)


def test_alignment_keeps_tilt_and_height():
    motion = a_motion(DOUBLE, clips=1, frames=30)
    pelvis = rest_pelvis(DOUBLE, motion.shape)
    anchors = Anchors.of(motion)
    aligned, _ = anchors.aligned(pelvis)
    assert torch.allclose(aligned.rotations[..., 0, 2, :], anchors.rotations[..., 0, 2, :])
    assert torch.allclose(aligned.translation[..., 2], anchors.translation[..., 2])
    tilted, _ = anchors.carried(_rigid(0.0, 0.5)[None], pelvis).aligned(pelvis)
    assert not torch.allclose(tilted.pack(), aligned.pack(), atol=1e-3)


def test_what_alignment_takes_away_it_gives_back():
    motion = a_motion(DOUBLE, clips=2, frames=30)
    pelvis = rest_pelvis(DOUBLE, motion.shape)
    anchors = Anchors.of(motion)
    aligned, T = anchors.aligned(pelvis)
    back = aligned.carried(T, pelvis)
    assert torch.allclose(back.pack(), anchors.pack(), atol=1e-9)


def test_aligning_moves_the_body_rigidly():
    motion = a_motion(DOUBLE, clips=1, frames=30)
    pelvis = rest_pelvis(DOUBLE, motion.shape)
    anchors = Anchors.of(motion)
    aligned, T = anchors.aligned(pelvis)
    some = torch.arange(0, 6900, 150)
    before, after = (
        DOUBLE.pose(cycle.motion(motion.shape, 1.0)).points(some) for cycle in (anchors, aligned)
    )
    moved = (before - T[:, None, None, :3, 3]) @ T[:, None, :3, :3]
    assert torch.allclose(moved, after, atol=1e-6)


def test_an_aligned_walk_goes_ahead_along_y():
    walk = a_walk(BODY, speed=1.2)
    turned = walk.carried(_rigid(2.0).float(), rest_pelvis(BODY, walk.shape))
    aligned, _ = Anchors.of(turned).aligned(rest_pelvis(BODY, walk.shape))
    assert aligned.translation[-1, 1] == pytest.approx(1.2, abs=1e-4)
    assert abs(float(aligned.translation[-1, 0])) < 1e-4
    assert math.isclose(float(aligned.duration), 1.0, abs_tol=1e-6)
