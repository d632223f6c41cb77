"""Makes clothes, by smooth random offsets of the body's surface, and furniture.

For scans of people whose surface no shape of the body model has. The offsets lie along the normals
of the unposed body and move with the skin, as close-fitting clothes about do.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Generator, Tensor

from recon.body.model import BodyModel
from recon.core.raster import differentiable_normals
from recon.core.skeleton import joint_index
from recon.simulation.settings import FurnitureName

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
    """Settings of simulated clothes: their distances from the skin and wavelengths, metres."""

    loose: float = 0.007
    """Median distance of loose cloth from the skin."""
    spread: float = 0.6
    """Standard deviation of that distance's logarithm."""
    drape: float = 0.18
    """Length over which this distance varies."""
    folds: float = 0.002
    """Standard deviation of the folds."""
    fold_length: float = 0.035
    """Length over which folds vary."""


def clothed(body: BodyModel, seed: int, clothing: Clothing | None = None) -> BodyModel:
    """Return a body model whose surface is offset by random clothes, equal for all shapes."""
    offset = clothing_offsets(body, seed, clothing)
    normals = differentiable_normals(body.template, body.faces)
    return body.replace(
        name=f"{body.name} clothed {seed}", template=body.template + offset[:, None] * normals
    )


def clothing_offsets(
    body: BodyModel, seed: int, clothing: Clothing | None = None
) -> Float[Tensor, " vertices"]:
    """Draw the distance between clothes and skin at every vertex, metres.

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
    """Draw a smooth random function of space; return its values at points, about N(0, 1).

    sqrt(2 / n) Σ cos(w·x + b) with w ~ N(0, I / length²): a Gaussian process whose correlation is
    exp(-d² / (2 length²)), by random Fourier features (Rahimi & Recht 2007).
    """
    waves = torch.randn(_WAVES, 3, generator=generator, dtype=torch.float64) / length
    phase = math.tau * torch.rand(_WAVES, generator=generator, dtype=torch.float64)
    angle = points.double() @ waves.to(points.device).T + phase.to(points.device)
    return math.sqrt(2 / _WAVES) * angle.cos().sum(-1).to(points)


_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_SIDES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
_LEG = 0.04
"""Thickness of legs of chairs and tables, metres."""
_BEHIND, _BESIDE, _BEFORE = -0.6, 0.8, 0.55
"""Metres from the middle of a motion at which furniture stands."""


@dataclass(frozen=True)
class FurnitureMesh:
    """A triangle mesh of furniture; corners counter-clockwise from outside; metres, z up."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]

    def placed(self, place: Sequence[float], heading: float = 0.0) -> "FurnitureMesh":
        """The mesh turned about z by `heading` (radians), then moved to `place`."""
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return FurnitureMesh(self.vertices @ turn.T + np.asarray(place, dtype=float), self.faces)


def joined_meshes(meshes: Sequence[FurnitureMesh]) -> FurnitureMesh:
    """Join several furniture meshes to one mesh."""
    if len(meshes) == 0:
        return FurnitureMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return FurnitureMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + k for mesh, k in zip(meshes, first, strict=True)]),
    )


def box(size: Sequence[float], bottom: float = 0.0) -> FurnitureMesh:
    """A box centred on the z axis with its lower side at height `bottom`; metres."""
    vertices = _CORNERS * np.asarray(size, dtype=float)
    return FurnitureMesh(vertices + np.array([0.0, 0.0, bottom + size[2] / 2]), _SIDES)


def table(width: float = 1.2, depth: float = 0.7, height: float = 0.73) -> FurnitureMesh:
    """A table: a plate on four legs, metres."""
    return joined_meshes(
        [box((width, depth, _LEG), height - _LEG), _four_legs(width, depth, height - _LEG)]
    )


def chair(width: float = 0.44, height: float = 0.45, back: float = 0.45) -> FurnitureMesh:
    """A chair whose back is at its rear (-y), so that whoever sits on it faces +y; metres."""
    seat = box((width, width, _LEG), height - _LEG)
    rest = box((width, _LEG, back), height).placed((0.0, (_LEG - width) / 2, 0.0))
    return joined_meshes([seat, rest, _four_legs(width, width, height - _LEG)])


def furniture_around(
    names: Sequence[FurnitureName], middle: Float[np.ndarray, "3"], heading: float
) -> FurnitureMesh:
    """Place furniture around a person, on the floor z = 0.

    Args:
        names: of the pieces, each at a place of its own: a chair behind, a table at the left, a
            box of 0.6 m at the right, a board of 0.45 m height before the shins.
        middle: where somebody stands, metres.
        heading: radians from the x axis to where somebody looks.
    """
    pieces = {
        "chair": chair().placed((0.0, _BEHIND, 0.0)),
        "table": table().placed((-_BESIDE, 0.0, 0.0), np.pi / 2),
        "box": box((0.5, 0.5, 0.6)).placed((_BESIDE, 0.0, 0.0)),
        "board": box((0.9, 0.03, 0.45)).placed((0.0, _BEFORE, 0.0)),
    }
    mesh = joined_meshes([pieces[name] for name in names])
    return mesh.placed((middle[0], middle[1], 0.0), heading - np.pi / 2)


def _four_legs(width: float, depth: float, height: float) -> FurnitureMesh:
    x, y = (width - _LEG) / 2, (depth - _LEG) / 2
    leg = box((_LEG, _LEG, height))
    return joined_meshes([leg.placed((sx * x, sy * y, 0.0)) for sx in (-1, 1) for sy in (-1, 1)])
