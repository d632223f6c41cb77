"""A small anchor-frame prior of made-up walks: real enough to be fitted, learned in a moment."""

import torch

from priors.anchor.frames import Anchors, rest_pelvis
from priors.anchor.networks import AnchorNetworks, AnchorWeights
from priors.anchor.prior import AnchorFrames
from recon.body.model import BodyModel
from recon.core.motion import Motion
from tests.walking import a_walk
from training.anchor.train import fitted_basis, fitted_spread

LATENT = 4


def walks(body: BodyModel, count=40, seed=0) -> list[Motion]:
    """Of any pace and stride, half of them with the other foot first."""
    random = torch.Generator().manual_seed(seed)
    found = []
    for k in range(count):
        period, speed = (torch.rand(2, generator=random) * 0.6 + 0.7).tolist()
        walk = a_walk(body, seconds=period, period=period, speed=speed, fps=25.0)
        if k % 2:
            walk = walk.replace(rotations=walk.rotations.clone())
            walk.rotations[:, [1, 2]] = walk.rotations[:, [2, 1]].clone()
        found.append(walk)
    return found


def tiny_weights(body: BodyModel) -> AnchorWeights:
    """Principal components; the networks beside them have learned nothing."""
    cycles = []
    for walk in walks(body):
        pelvis = rest_pelvis(body, walk.shape)
        cycles.append(Anchors.of(walk).aligned(pelvis)[0].pack())
    rows = torch.stack(cycles)
    torch.manual_seed(0)
    networks = AnchorNetworks(fitted_basis(rows, 8), LATENT, body.shape_size, 16).eval()
    networks.requires_grad_(False)
    mean, log_variance = networks.posterior(rows)
    spread = fitted_spread(mean, log_variance.exp(), 4)
    return AnchorWeights(networks, spread)


def tiny_prior(body: BodyModel) -> AnchorFrames:
    return AnchorFrames(tiny_weights(body), body)
