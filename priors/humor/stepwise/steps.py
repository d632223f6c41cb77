"""HuMoR's networks evaluated on all steps of given motions at once, without a rollout."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.networks import HumorNetworks
from priors.humor.state import Frame, State
from recon.core import rotations as so3
from recon.core.struct import TensorStruct

_SHRINKAGE = 0.05
"""Share by which variances are raised, so that what repeats itself does not count without end."""


@dataclass(frozen=True)
class StepOutputs(TensorStruct):
    """Outputs of the networks for the steps of motions; axes (clips, steps)."""

    error: Float[Tensor, "clips steps 207"]
    """The raw step from where the decoder lands to where the motion went."""
    surprise: Float[Tensor, "clips steps"]
    """KL(q(z | x_(t-1), x_t) ‖ p(z | x_(t-1))), nats."""
    contacts: Float[Tensor, "clips steps 9"]
    """Logits."""


def explain(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> StepOutputs:
    """Every step, by the posterior's mean latent.

    Args:
        networks: in the states' precision.
        states: of motions at 30 Hz, axes (clips, time).
        pelvis: of the bodies at rest, horizontally.
    """
    steps = _Steps.of(states, pelvis)
    mean, log_variance = networks.posterior(steps.start, steps.end)
    prior_mean, prior_log_variance = networks.prior(steps.start)
    raw = networks.decode(steps.start, mean)
    return StepOutputs(
        error=steps.error(raw),
        surprise=divergence(mean, log_variance, prior_mean, prior_log_variance),
        contacts=raw[..., _MOVED:],
    )


def latents_of(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mean and log-variance of the posterior of every step's latent, then those of the prior."""
    steps = _Steps.of(states, pelvis)
    return *networks.posterior(steps.start, steps.end), *networks.prior(steps.start)


@dataclass(frozen=True)
class _Steps(TensorStruct):
    """States at both ends of all steps, packed (`State.pack`), in the frame of the start.

    The same as `Frame.enter` and `step_between` make, with all vectors turned at once.
    """

    start: Float[Tensor, "clips steps 339"]
    end: Float[Tensor, "clips steps 339"]
    rotations: Float[Tensor, "2 clips steps 22 3 3"]
    """Rotations of root and joints, at the start and at the end."""

    @classmethod
    def of(cls, states: State, pelvis: Float[Tensor, "clips 3"]) -> "_Steps":
        frame = Frame.of(states[:, :-1])
        level = torch.cat((frame.origin[..., None, :], pelvis[:, None, None].expand_as(
            frame.origin[..., None, :])), -2)  # fmt: skip
        vectors = torch.cat(
            (
                states.translation[..., None, :],
                states.velocity[..., None, :],
                states.angular_velocity[..., None, :],
                states.root.mT,
                states.joints,
                states.joint_velocities,
            ),
            -2,
        )
        # translation and joints are places, and joints turn about the pelvis
        about, back = _placed(vectors.dtype, vectors.device)
        ends = torch.stack((vectors[:, :-1], vectors[:, 1:])) - about @ level
        turned = ends @ frame.turn.mT + back * pelvis[:, None, None]
        root = turned[..., 3:6, :].mT
        pose = torch.stack((states.pose[:, :-1], states.pose[:, 1:]))
        packed = torch.cat(
            (
                turned[..., :2, :].flatten(-2),
                root.flatten(-2),
                turned[..., 2, :],
                pose.flatten(-3),
                turned[..., 6:, :].flatten(-2),
            ),
            -1,
        )
        rotations = torch.cat((root[..., None, :, :], pose), -3)
        return cls(packed[0], packed[1], rotations)

    def error(self, raw: Float[Tensor, "clips steps 216"]) -> Float[Tensor, "clips steps 207"]:
        """The raw step from where a step of the decoder leads to the end."""
        straight = self.end - self.start
        turns = torch.cat((raw[..., 6:9], raw[..., 12:75]), -1).unflatten(-1, (-1, 3))
        before, after = self.rotations.unbind(0)
        left = so3.axis_sine(after @ (so3.exp(turns) @ before).mT).flatten(-2)
        return torch.cat(
            (
                straight[..., :6] - raw[..., :6],
                left[..., :3],
                straight[..., 15:18] - raw[..., 9:12],
                left[..., 3:],
                straight[..., 207:] - raw[..., 75:_MOVED],
            ),
            -1,
        )


_MOVED = 207
"""Numbers of a raw step before its contact logits."""


@lru_cache(maxsize=8)
def _placed(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Shares of a frame's origin and the pelvis that vectors lose, and of the pelvis put back."""
    about = torch.zeros(50, 2, dtype=dtype, device=device)
    back = torch.zeros(50, 1, dtype=dtype, device=device)
    about[0, 0] = 1.0
    about[6:28] = 1.0
    back[6:28] = 1.0
    return about, back


def divergence(
    mean: Float[Tensor, "*batch 48"],
    log_variance: Float[Tensor, "*batch 48"],
    prior_mean: Float[Tensor, "*batch 48"],
    prior_log_variance: Float[Tensor, "*batch 48"],
) -> Float[Tensor, "*batch"]:
    """KL(q ‖ p) of two Gaussians with independent numbers, nats."""
    ratio = log_variance - prior_log_variance
    away = (mean - prior_mean).square() * (-prior_log_variance).exp()
    return 0.5 * (ratio.exp() + away - 1 - ratio).sum(-1)


def error_whitening(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> Float[Tensor, "207 207"]:
    """U with C⁻¹ = U Uᵀ for the covariance C (about zero) of the decoder's errors on motions."""
    with torch.no_grad():
        errors = explain(networks, states, pelvis).error.flatten(0, 1).double()
    covariance = errors.mT @ errors / len(errors)
    covariance = covariance + _SHRINKAGE * torch.diag(covariance.diagonal() + 1e-9)
    factor = torch.linalg.cholesky(covariance)
    identity = torch.eye(len(factor), dtype=factor.dtype)
    return torch.linalg.solve_triangular(factor, identity, upper=False).mT.contiguous()
