"""Legs of one recording under the trunk and arms of another."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humor.training.variety.limits import above_ground
from priors.humor.training.variety.moments import Moments
from recon.core import rotations as so3

TRUNK = (3, 6, 9)
"""Joints of the spine, from the lowest."""
UPPER = (*TRUNK, *range(12, 22))
"""Joints of the upper half."""
_FARTHEST = math.radians(50)
"""Most by which the two pelvises differ in tilt; the spine takes up the difference."""
_HANDS = (20, 21)


def joined(legs: Moments, trunks: Moments) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Windows with the lower half of the first and the upper half of the second.

    The trunk is tilted in the world as it was recorded, and turned as the legs are: relative to
    the heading of its pelvis, its orientation is that of its own recording. What the two pelvises
    differ by is shared by the three joints of the spine.

    Refused are windows in which a hand carries weight in either, where pelvises differ too much,
    or where arms would reach into the ground.
    """
    differ = so3.log(_level(legs).mT @ _level(trunks))
    third = so3.exp(differ / 3)
    rotations = legs.rotations.clone()
    rotations[:, :, list(UPPER)] = trunks.rotations[:, :, list(UPPER)]
    # third · third · third · s1 · s2 · s3, with each third moved to its own joint
    below = torch.eye(3).to(third)
    for joint in TRUNK:
        own = trunks.rotations[:, :, joint]
        rotations[:, :, joint] = below.mT @ third @ below @ own
        below = below @ own
    made = legs.derived(rotations=rotations)
    near = (differ.norm(dim=-1) < _FARTHEST).all(1)
    hands = legs.ever(*_HANDS) | trunks.ever(*_HANDS)
    return made, near & ~hands & above_ground(legs, made)


def _level(moments: Moments) -> Float[Tensor, "windows times 3 3"]:
    """Orientations of the pelvis less its heading."""
    root = moments.rotations[:, :, 0]
    return so3.heading(root) @ root
