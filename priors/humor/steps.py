"""HuMoR's networks evaluated on all steps of given motions at once, without a rollout."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.networks import HumorNetworks
from priors.humor.state import Frame, State, compose, step_between
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
    landed: State
    """States that the decoder predicts, in the frame of the given motion."""


def explain(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> StepOutputs:
    """Every step, by the posterior's mean latent.

    Args:
        networks: in the states' precision.
        states: of motions at 30 Hz, axes (clips, time).
        pelvis: of the bodies at rest, horizontally.
    """
    frame, start, target = _pairs(states, pelvis)
    x = start.pack()
    mean, log_variance = networks.posterior(x, target.pack())
    prior_mean, prior_log_variance = networks.prior(x)
    after, contacts = compose(start, networks.decode(x, mean))
    return StepOutputs(
        error=step_between(after, target),
        surprise=divergence(mean, log_variance, prior_mean, prior_log_variance),
        contacts=contacts,
        landed=frame.leave(after, pelvis[:, None]),
    )


def latents_of(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mean and log-variance of the posterior of every step's latent, then those of the prior."""
    _, start, target = _pairs(states, pelvis)
    x = start.pack()
    return *networks.posterior(x, target.pack()), *networks.prior(x)


def _pairs(states: State, pelvis: Float[Tensor, "clips 3"]) -> tuple[Frame, State, State]:
    """Frames of all states but the last, and both ends of every step as seen from there."""
    offset = pelvis[:, None]
    past, future = states.map(lambda t: t[:, :-1]), states.map(lambda t: t[:, 1:])
    frame = Frame.of(past)
    return frame, frame.enter(past, offset), frame.enter(future, offset)


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
