"""Losses of the anchor-frame VAE: parameters, surface, and how far codes are from a normal."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.anchor.frames import POSE_NUMBERS, Anchors
from priors.anchor.networks import AnchorNetworks
from recon.body.model import BodyModel
from training.anchor.corpus import CycleBatch


@dataclass(frozen=True)
class Reconstructed:
    """Codes and cycles that the networks make of a batch of cycles."""

    mean: Float[Tensor, "cycles latent"]
    log_variance: Float[Tensor, "cycles latent"]
    latent: Float[Tensor, "cycles latent"]
    """The code that was decoded."""
    normalised: Float[Tensor, "cycles 100 124"]


def reconstruct(
    networks: AnchorNetworks,
    rows: Float[Tensor, "cycles 100 124"],
    shape: Float[Tensor, "cycles shape"],
    random: torch.Generator | None,
) -> Reconstructed:
    """Encode, draw a code, decode.

    Args:
        networks: to use.
        rows: chi of aligned cycles.
        shape: of their bodies.
        random: draws the codes; None takes their means.
    """
    mean, log_variance = networks.posterior(rows)
    latent = mean
    if random is not None:
        noise = torch.randn(mean.shape, generator=random).to(mean)
        latent = mean + noise * (0.5 * log_variance).exp()
    return Reconstructed(mean, log_variance, latent, networks.normalised(latent, shape))


def parameter_losses(
    networks: AnchorNetworks, found: Reconstructed, rows: Float[Tensor, "cycles 100 124"]
) -> dict[str, Tensor]:
    """Mean squared errors of pose, translation and time, normalised (Marsot et al., eq. 3)."""
    error = (found.normalised - networks.basis.normalised(rows)).square()
    return {
        "pose": error[..., :POSE_NUMBERS].mean(),
        "translation": error[..., POSE_NUMBERS:-1].mean(),
        "time": error[..., -1].mean(),
    }


def surface_error(
    networks: AnchorNetworks,
    found: Reconstructed,
    batch: CycleBatch,
    body: BodyModel,
    vertices: Int[Tensor, " points"],
    anchors: Int[Tensor, " some"],
) -> Float[Tensor, " cycles"]:
    """Mean squared distance of the surface's points, metres² (eq. 4 and 6); the true shape.

    Args:
        networks: that made the cycles.
        found: cycles.
        batch: what they shall be.
        body: that performs both.
        vertices: points of the surface that are compared.
        anchors: numbers of those that are compared.
    """
    made = Anchors.unpack(networks.basis.metric(found.normalised))
    points = [
        body.pose(cycle.map(lambda rows: rows[:, anchors]).motion(batch.shape, 1.0)).points(
            vertices
        )
        for cycle in (made, batch.anchors)
    ]
    return (points[0] - points[1]).square().sum(-1).mean((-1, -2))


def divergence(found: Reconstructed) -> Float[Tensor, "cycles latent"]:
    """KL(q(z | cycle) || N(0, I)) per dimension, nats."""
    return 0.5 * (found.mean.square() + found.log_variance.exp() - 1 - found.log_variance)
