"""Bodies that rest on something else than their feet."""

import math

import torch

from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.movement import support_findings
from tests.filmed import bundled
from tests.standing_body import standing

FRAMES, FPS = 60, 30.0


def posed(hip: float, out: float, knee: float) -> Motion:
    """A body that rests with its hips flexed and turned out, and its knees bent, radians."""
    still = standing(bundled().to(dtype=torch.float64), torch.zeros(FRAMES, 3).double(), FPS)
    still = still.to(dtype=torch.float32)
    rotations = still.rotations.clone()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        outwards = so3.exp(torch.tensor([0.0, sign * out, 0.0]))
        flexed = so3.exp(torch.tensor([-hip, 0.0, 0.0]))
        rotations[..., joint_index(f"{side}_hip"), :, :] = outwards @ flexed
        bent = so3.exp(torch.tensor([knee, 0.0, 0.0]))
        rotations[..., joint_index(f"{side}_knee"), :, :] = bent
    return still.replace(rotations=rotations)


def test_a_body_on_crossed_legs_is_said_to_sit():
    """A person who sits on a table was told about feet of several heights, and of no seat."""
    seated = posed(math.radians(90), math.radians(40), math.radians(140))
    (finding,) = support_findings(seated, bundled())
    assert "pelvis low over its feet" in finding.message
    assert finding.frames[0][1] - finding.frames[0][0] > 0.8 * FPS


def test_a_body_on_its_feet_is_not_said_to_sit():
    assert support_findings(posed(0.0, 0.0, 0.0), bundled()) == []
