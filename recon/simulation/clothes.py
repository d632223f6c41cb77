"""Clothes: the body's surface moved outwards by smooth random fields.

For scans of people whose surface no shape of the body model has. The offsets lie along the normals
of the unposed body and move with the skin, as close-fitting clothes about do.
"""

import math
from dataclasses import dataclass
from types import MappingProxyType

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from recon.body.model import BodyModel
from recon.core.geometry.normals import tensor_normals
from recon.core.skeleton import joint_index

COVER = MappingProxyType(
    {
        "pelvis": 1.0, "spine1": 1.0, "spine2": 1.0, "spine3": 1.0,
        "left_hip": 1.0, "right_hip": 1.0, "left_knee": 0.6, "right_knee": 0.6,
        "left_collar": 0.8, "right_collar": 0.8, "left_shoulder": 0.9, "right_shoulder": 0.9,
        "left_elbow": 0.5, "right_elbow": 0.5, "neck": 0.2,
    }
)  # fmt: skip
"""How loose clothes are on what a joint carries; hands, feet and head are bare."""
_WAVES = 128
"""Number of waves of a random field."""


@dataclass(frozen=True)
class Clothing:
    """How clothes stand off the skin where they are loosest, metres."""

    loose: float = 0.007
    """Median distance from the skin of what hangs."""
    spread: float = 0.6
    """Standard deviation of that distance's logarithm."""
    drape: float = 0.18
    """Length over which it varies."""
    folds: float = 0.002
    """Standard deviation of the folds."""
    fold_length: float = 0.035
    """Length over which folds vary."""


def clothed(body: BodyModel, seed: int, clothing: Clothing | None = None) -> BodyModel:
    """The body in clothes, with its joints and shape space; clothes do not depend on the shape."""
    offset = offsets(body, seed, clothing)
    normals = tensor_normals(body.template, body.faces)
    return body.replace(
        name=f"{body.name} clothed {seed}", template=body.template + offset[:, None] * normals
    )


def offsets(
    body: BodyModel, seed: int, clothing: Clothing | None = None
) -> Float[Tensor, " vertices"]:
    """How far clothes stand off the skin at every vertex, metres.

    cover (loose exp(spread f) + folds g) with independent random fields f and g: what hangs never
    lies inside the skin, folds may press into it a little.
    """
    clothing = Clothing() if clothing is None else clothing
    generator = Generator().manual_seed(seed)
    hang = random_field(body.template, clothing.drape, generator)
    folds = random_field(body.template, clothing.fold_length, generator)
    cover = body.template.new_zeros(body.weights.shape[1])
    cover[[joint_index(name) for name in COVER]] = cover.new_tensor(list(COVER.values()))
    away = clothing.loose * (clothing.spread * hang).exp() + clothing.folds * folds
    return (body.weights @ cover) * away


def random_field(
    points: Float[Tensor, "points 3"], length: float, generator: Generator
) -> Float[Tensor, " points"]:
    """A smooth random function at some points, about N(0, 1) at each.

    sqrt(2 / n) Σ cos(w·x + b) with w ~ N(0, I / length²): a Gaussian process whose correlation is
    exp(-d² / (2 length²)), by random Fourier features (Rahimi & Recht 2007).
    """
    waves = torch.randn(_WAVES, 3, generator=generator, dtype=torch.float64) / length
    phase = math.tau * torch.rand(_WAVES, generator=generator, dtype=torch.float64)
    angle = points.double() @ waves.to(points.device).T + phase.to(points.device)
    return math.sqrt(2 / _WAVES) * angle.cos().sum(-1).to(points)
