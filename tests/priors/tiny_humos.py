"""A small HUMOS prior of made-up walks: real enough to be fitted, learned in a moment."""

import torch

from priors.humos.frames import BodyFrames
from priors.humos.networks import HumosWeights, WindowNetworks
from priors.humos.prior import Humos
from recon.body.model import BodyModel
from tests.walking import a_walk
from training.humos.train import fitted_basis, fitted_codes

LATENT, FRAMES = 6, 40


def rows_of_walks(body: BodyModel, count=24, seed=0) -> torch.Tensor:
    """Two seconds each, of any pace and stride, packed."""
    random = torch.Generator().manual_seed(seed)
    rows = []
    for _ in range(count):
        period, speed = (torch.rand(2, generator=random) * 0.6 + 0.7).tolist()
        walk = a_walk(body, seconds=2.0, period=period, speed=speed, fps=20.0)
        rows.append(BodyFrames.of(walk.window(0, FRAMES), body)[0].pack())
    return torch.stack(rows)


def tiny_weights(body: BodyModel) -> HumosWeights:
    """Principal components; the networks beside them have learned nothing."""
    rows = rows_of_walks(body)
    torch.manual_seed(0)
    networks = WindowNetworks(fitted_basis(rows, 16), LATENT, body.shape_size, 16, 1).eval()
    networks.requires_grad_(False)
    shape = torch.zeros(len(rows), body.shape_size)
    exists = torch.ones(len(rows), FRAMES // 8 + 1, dtype=torch.bool)
    mean, log_variance = networks.posterior(rows, shape, exists)
    density = fitted_codes(
        mean.flatten(0, 1),
        log_variance.exp().mean((0, 1)),
        (mean[:, :-1].flatten(0, 1), mean[:, 1:].flatten(0, 1)),
    )
    return HumosWeights(networks, density, FRAMES)


def tiny_prior(body: BodyModel) -> Humos:
    return Humos(tiny_weights(body), body)
