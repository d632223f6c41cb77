"""Runners-up of a fit: told with their energies, each once; the same motion is none."""

import math
from dataclasses import replace

import pytest
import torch

from observations.joints3d import Joints3D
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import MIRROR
from recon.core.struct import concatenate
from recon.diagnosis.certainty import alternatives
from recon.fitting.records import ClipFit
from recon.method.free import FreeMotion
from recon.method.reconstruction import solve
from recon.method.stages import ComparedHypotheses, Stage
from recon.solver.lbfgs import LBFGS
from tests import laws

FRAMES = 6


class Nothing:
    """A method that moves next to nothing, so that hypotheses stay what they are."""

    def stages(self, data):
        """One iteration of the shape."""
        free = frozenset({"shape"})
        return (Stage("shape", FreeMotion(), data, free, LBFGS(max_iterations=1)),)


def turned(motion: Motion, degrees: float) -> Motion:
    """The motion with another heading in the same place."""
    about = so3.about_z(torch.tensor(math.radians(degrees))).to(motion.rotations)
    root = about @ motion.rotations[:, :, :1]
    return motion.replace(rotations=torch.cat((root, motion.rotations[:, :, 1:]), 2))


def swapped(motion: Motion) -> Motion:
    """The motion with the legs' rotations mirrored to the other side."""
    flip = torch.tensor([1.0, -1.0, -1.0]).to(motion.rotations)
    legs = [1, 2, 4, 5, 7, 8, 10, 11]
    rotations = motion.rotations.clone()
    other = motion.rotations[:, :, [MIRROR[k] for k in legs]]
    rotations[:, :, legs] = so3.exp(so3.log(other) * flip)
    return motion.replace(rotations=rotations)


def fitted(body, first: Motion, others: list[Motion]) -> ClipFit:
    """A fit to the joints of the first of several hypotheses."""
    joints = body.pose(first).joints + 0.01  # metres, so that no energy is zero
    seen = Joints3D(joints, torch.ones(joints.shape[:-1]).bool(), tuple(range(22)), first.fps)
    found = solve([seen], Nothing(), body, start=first, others=others)
    return ClipFit(found, (), True, torch.eye(4)[None], (seen,))


def test_a_heading_that_was_given_up_is_told_with_its_energy(body):
    truth = laws.a_motion(body, clips=1, frames=FRAMES)
    others = [turned(truth, 120.0), turned(truth, 121.0), turned(truth, -90.0)]
    (one, other) = alternatives(fitted(body, truth, others))
    assert (one.kind, other.kind) == ("heading", "heading")
    assert one.turn == pytest.approx(90.0, abs=1.0)
    assert other.turn == pytest.approx(120.0, abs=1.0)  # 121 degrees are the same motion
    assert one.chosen_energy < one.energy < other.energy
    assert one.excess == pytest.approx(one.energy / one.chosen_energy - 1)
    assert "facing 90 degrees elsewhere" in str(one)
    assert one.report()["message"] == str(one)


def test_exchanged_legs_are_told_from_another_posture(body):
    stride = laws.a_motion(body, clips=1, frames=FRAMES)
    rotations = torch.eye(3).to(stride.rotations).expand(1, FRAMES, 22, 3, 3).clone()
    rotations[:, :, 0] = stride.rotations[:, :, 0]
    rotations[:, :, 1] = so3.exp(torch.tensor([0.6, 0.0, 0.0]).to(rotations))
    rotations[:, :, 2] = so3.exp(torch.tensor([-0.6, 0.0, 0.0]).to(rotations))
    truth = stride.replace(rotations=rotations)
    (legs,) = alternatives(fitted(body, truth, [swapped(truth)]))
    assert legs.kind == "leg order"
    bent = rotations.clone()
    bent[:, :, 3] = so3.exp(torch.tensor([1.2, 0.0, 0.0]).to(rotations))
    (posture,) = alternatives(fitted(body, truth, [truth.replace(rotations=bent)]))
    assert posture.kind == "posture"


def test_hypotheses_that_came_to_the_same_motion_are_none(body):
    truth = laws.a_motion(body, clips=1, frames=FRAMES)
    near = truth.replace(translation=truth.translation + 0.01)
    assert alternatives(fitted(body, truth, [near])) == ()
    alone = fitted(body, truth, [])
    assert alone.comparisons == ()
    assert alternatives(alone) == ()


def test_a_hypothesis_that_is_not_finite_is_no_alternative(body):
    truth = laws.a_motion(body, clips=1, frames=FRAMES)
    rows = concatenate([truth, turned(truth, 90.0), turned(truth, 180.0)])
    compared = ComparedHypotheses(
        torch.zeros(3, dtype=torch.long),
        torch.tensor([1.0, torch.nan, 1.5]),
        torch.tensor([True, False, False]),
        rows,
    )
    found = fitted(body, truth, [])
    reports = (replace(found.result.reports[0], compared=compared),)
    (one,) = alternatives(replace(found, result=replace(found.result, reports=reports)))
    assert one.turn == pytest.approx(180.0, abs=1.0)
    assert one.excess == pytest.approx(0.5)
