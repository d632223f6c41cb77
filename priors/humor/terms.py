"""Energies that tie HuMoR's predictions to the body: joints, bones and contacts (section 6.5).

They need a prior that predicts contacts and joints beside the pose. Sums over frames are at 30 Hz,
the prior's own rate; frames that do not exist count nothing.
"""

from jaxtyping import Float
from torch import Tensor

from recon.core.skeleton import PARENTS
from recon.method.protocols import Estimate

_TOUCHING = 0.08
"""Metres a joint in contact may be above or below the ground (published)."""


def joint_consistency(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ |p - p̂|² between the body's joints p and the predicted joints p̂; metres²."""
    away = estimate.body.joints - _predicted(estimate)
    squared = away.square().sum((-1, -2))
    return 0.5 * squared.where(estimate.motion.valid, 0.0).sum(-1)


def bone_length(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ (l_t - l_(t-1))² of the bone lengths of the predicted joints; metres²."""
    joints = _predicted(estimate)
    lengths = (joints[..., 1:, :] - joints[..., PARENTS[1:], :]).norm(dim=-1)
    change = lengths.diff(dim=-2).square().sum(-1)
    return 0.5 * change.where(_valid_pairs(estimate), 0.0).sum(-1)


def contact_velocity(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ c |p_t - p_(t-1)|² of the body's joints, c their probability of contact; metres²."""
    step = estimate.body.joints.diff(dim=-3).square().sum(-1)
    moved = (_contacts(estimate)[..., 1:, :] * step).sum(-1)
    return 0.5 * moved.where(_valid_pairs(estimate), 0.0).sum(-1)


def contact_height(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Σ c max(|z| - 8 cm, 0) of the body's joints above the ground z = 0; metres."""
    away = (estimate.body.joints[..., 2].abs() - _TOUCHING).relu()
    height = (_contacts(estimate) * away).sum(-1)
    return height.where(estimate.motion.valid, 0.0).sum(-1)


def _valid_pairs(estimate: Estimate) -> Tensor:
    valid = estimate.motion.valid
    return valid[..., 1:] & valid[..., :-1]


def _predicted(estimate: Estimate) -> Float[Tensor, "*batch time 22 3"]:
    if estimate.decoded.joints is None:
        raise ValueError("expected a prior that predicts joints beside the pose, such as Humor")
    return estimate.decoded.joints


def _contacts(estimate: Estimate) -> Float[Tensor, "*batch time 22"]:
    if estimate.decoded.contacts is None:
        raise ValueError("expected a prior that predicts contacts, such as Humor")
    return estimate.decoded.contacts
