"""Feet that slide are held, and what stands or flies is left alone."""

import math

import pytest
import torch

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.fitting.retargeting import airborne_frames, corrected_on_ground
from recon.method.protocols import Decoded, Estimate
from recon.physics.energies import floating, slide


@pytest.fixture(scope="module")
def body():
    return BodyModel.load()


def standing(body, speed=0.0, height=0.0, frames=31) -> Motion:
    """A body at rest that is drawn along the ground."""
    turns = torch.eye(3).repeat(1, frames, 22, 1, 1)
    turns[:, :, 0] = so3.exp(torch.tensor([math.pi / 2, 0.0, 0.0]))
    place = torch.zeros(1, frames, 3)
    place[..., 1] = speed * torch.arange(frames) / 30
    motion = Motion.create(place, turns, torch.zeros(1, body.shape_size), 30.0)
    place[..., 2] = height - body.pose(motion).vertices[..., 2].min()
    return motion.replace(translation=place)


def stood(motion, body):
    return corrected_on_ground(motion, motion, airborne_frames(motion, body), body).detach()


def energy(measure, motion, body) -> float:
    estimate = Estimate(Decoded(motion), body.pose(motion), Scene.create(1, like=body.template))
    return float(measure(estimate))


def test_sliding_feet_are_held(body):
    sliding = standing(body, speed=0.15)
    found = stood(sliding, body)
    assert energy(slide, found, body) < 0.2 * energy(slide, sliding, body)
    assert found.fps == sliding.fps
    assert found.frames == sliding.frames
    moved = (found.translation - sliding.translation).norm(dim=-1)
    assert moved.max() < 0.15


def test_what_stands_stays(body):
    still = standing(body)
    found = stood(still, body)
    assert (body.pose(found).joints - body.pose(still).joints).norm(dim=-1).mean() < 5e-3


def test_what_floats_comes_down(body):
    above = standing(body, height=0.04)
    found = stood(above, body)
    assert energy(floating, found, body) < 0.2 * energy(floating, above, body)
    assert found.rotations.isfinite().all()


def test_every_clip_for_itself(body):
    both = standing(body, speed=0.15).map(lambda x: x.repeat(2, *[1] * (x.dim() - 1)))
    both = both.replace(translation=both.translation * torch.tensor([1.0, 0.0, 1.0]))
    other = standing(body)
    pair = both.replace(translation=torch.cat((both.translation[:1], other.translation)))
    alone = stood(other, body)
    torch.testing.assert_close(
        stood(pair, body).translation[1:], alone.translation, atol=2e-3, rtol=0
    )


def test_who_flies_is_left_in_the_air(body):
    above = standing(body, height=0.1)
    assert bool(airborne_frames(above, body).all())
    found = stood(above, body)
    assert float((found.translation - above.translation).abs().max()) < 1e-2


def test_accelerations_are_those_of_the_other_motion(body):
    """A motion that trembles, beside one that does not."""
    still = standing(body)
    up = 0.003 * torch.arange(still.frames).fmod(2)[:, None] * torch.tensor([0.0, 0.0, 1.0])
    trembling = still.replace(translation=still.translation + up)
    found = corrected_on_ground(trembling, still, airborne_frames(still, body), body).detach()

    def shake(motion):
        return float(motion.translation[0, :, 2].diff(n=2).abs().mean())

    assert shake(found) < 0.2 * shake(trembling)
