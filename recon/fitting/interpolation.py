"""Interpolates between two gait cycles in the prior's latent space."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from priors.anchor.frames import ANCHORS, Anchors, rest_pelvis
from priors.anchor.prior import AnchorFrames, AnchorVariables
from recon.body.cycles import (
    LONGEST_CYCLE,
    SHORTEST_CYCLE,
    THRESHOLD,
    Cycle,
    find_cycles,
    hip_flexion,
)
from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion

_MAX_RETURN_RAD = math.radians(10)
"""Largest difference (rad) of either hip's flexion between start and end of a whole cycle."""
_FEET = ((7, 10), (8, 11))
"""Joint indices of ankle and toes, left and right."""
_MIN_CYCLE_SHARE = 0.5
"""Share of a clip that a cycle found in it must last; with shorter ones it is several cycles."""


def interpolated_cycle(
    prior: AnchorFrames, a: AnchorVariables, b: AnchorVariables, share: float
) -> AnchorVariables:
    """Interpolate latent codes and shapes of cycles: (1-k) z_a + k z_b with k = `share`.

    See Marsot et al., section 5.2. Codes hold neither heading nor place on the ground: the first
    pelvis lies between those of `a` and `b`, and the heading on the shorter arc between theirs.
    """
    shape = torch.lerp(a.shape, b.shape, share)
    base = [x.base for x in (a, b)]
    pelvis = [
        (T @ _pelvis_column(prior, x.shape))[..., :3, :] for T, x in zip(base, (a, b), strict=True)
    ]
    fraction = shape.new_full(shape.shape[:-1], share)
    turn = so3.interpolate(base[0][..., :3, :3], base[1][..., :3, :3], fraction)
    rest = _pelvis_column(prior, shape)[..., :3, :]
    place = torch.lerp(pelvis[0], pelvis[1], share) - turn @ rest
    upper = torch.cat((turn, place), -1)
    return a.replace(
        latent=torch.lerp(a.latent, b.latent, share),
        shape=shape,
        base=torch.cat((upper, base[0][..., 3:, :]), -2),
    )


def motion_of_cycle(prior: AnchorFrames, variables: AnchorVariables, fps: float) -> Motion:
    """Decode a batch of one cycle to a motion at `fps` that begins at the cycle's start.

    Raises:
        ValueError: when its duration is not plausible for a cycle.
    """
    with torch.no_grad():
        anchors: Anchors = prior.anchors(variables)
    duration = float(anchors.duration[0])
    if not SHORTEST_CYCLE / 2 <= duration <= 2 * LONGEST_CYCLE:
        raise ReconError(
            f"expected a gait cycle of {SHORTEST_CYCLE / 2:g} to {2 * LONGEST_CYCLE:g} s, but the "
            f"weights decode one of {duration:.2f} s: one of the motions is unlike those that the "
            "weights were trained on; give another motion"
        )
    motion = anchors.motion(variables.shape, (ANCHORS - 1) / duration)
    return motion.replace(start_time=variables.start_time).resample(fps)


def cycles_of(motion: Motion) -> tuple[Cycle, ...]:
    """Find the gait cycles of one clip; the whole clip if it is one cycle itself.

    It is one if it lasts 0.3 to 3 s, its hips return to where they began, and no cycle found in it
    is much shorter. It begins with the foot of the thigh that is in front.
    """
    found = find_cycles(motion)
    last = motion.duration
    flexion = hip_flexion(motion)
    returns = abs(flexion[-1] - flexion[0]).max() <= _MAX_RETURN_RAD
    swings = (flexion.max(0) - flexion.min(0)).max() > _MAX_RETURN_RAD
    long = all(cycle.duration > _MIN_CYCLE_SHARE * last for cycle in found)
    if not (SHORTEST_CYCLE <= last <= LONGEST_CYCLE and returns and swings and long):
        return found
    left, right = flexion[0]
    cost = min((cycle.cost for cycle in found), default=THRESHOLD)
    side = "left" if left > right else "right"
    return (Cycle(motion.start_time, motion.start_time + last, side, cost),)


def foot_above_other(joints: Float[Tensor, "*batch time 22 3"]) -> Float[Tensor, "*batch time"]:
    """Return the height (m) of the left foot above the right, each by its lower joint."""
    left, right = (joints[..., [foot, toe], 2].amin(-1) for foot, toe in _FEET)
    return left - right


def curve_correlation(
    a: Float[Tensor, "first time"], b: Float[Tensor, "second time"]
) -> Float[Tensor, "first second"]:
    """Return the uncentred correlations (-1 to 1) of two sets of curves."""
    unit = [x / x.norm(dim=-1, keepdim=True).clamp(min=1e-9) for x in (a, b)]
    return unit[0] @ unit[1].mT


def _pelvis_column(prior: AnchorFrames, shape: Tensor) -> Tensor:
    """Return the pelvis of the rest pose as a homogeneous column vector."""
    pelvis = rest_pelvis(prior.body, shape)
    return torch.cat((pelvis, torch.ones_like(pelvis[..., :1])), -1)[..., None]
