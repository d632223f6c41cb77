"""Furniture as triangle meshes: boxes, chairs and tables that stand in a room."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from recon.simulation.settings import FurnitureName

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
    """Triangles whose corners run counter-clockwise seen from outside; metres, z up."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]

    def placed(self, place: Sequence[float], heading: float = 0.0) -> "FurnitureMesh":
        """The mesh turned about z by `heading` (radians), then moved to `place`."""
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return FurnitureMesh(self.vertices @ turn.T + np.asarray(place, dtype=float), self.faces)


def together(meshes: Sequence[FurnitureMesh]) -> FurnitureMesh:
    """Several meshes as one."""
    if len(meshes) == 0:
        return FurnitureMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return FurnitureMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + k for mesh, k in zip(meshes, first, strict=True)]),
    )


def box(size: Sequence[float], bottom: float = 0.0) -> FurnitureMesh:
    """A box about the z axis whose lowest side is at height `bottom`; metres."""
    vertices = _CORNERS * np.asarray(size, dtype=float)
    return FurnitureMesh(vertices + np.array([0.0, 0.0, bottom + size[2] / 2]), _SIDES)


def table(width: float = 1.2, depth: float = 0.7, height: float = 0.73) -> FurnitureMesh:
    """A plate on four legs, metres."""
    return together([box((width, depth, _LEG), height - _LEG), _legs(width, depth, height - _LEG)])


def chair(width: float = 0.44, height: float = 0.45, back: float = 0.45) -> FurnitureMesh:
    """A seat on four legs with a back at its rear (-y), metres; whoever sits on it faces +y."""
    seat = box((width, width, _LEG), height - _LEG)
    rest = box((width, _LEG, back), height).placed((0.0, (_LEG - width) / 2, 0.0))
    return together([seat, rest, _legs(width, width, height - _LEG)])


def furnished(
    names: Sequence[FurnitureName], middle: Float[np.ndarray, "3"], heading: float
) -> FurnitureMesh:
    """Furniture around somebody, on the floor z = 0.

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
    mesh = together([pieces[name] for name in names])
    return mesh.placed((middle[0], middle[1], 0.0), heading - np.pi / 2)


def _legs(width: float, depth: float, height: float) -> FurnitureMesh:
    x, y = (width - _LEG) / 2, (depth - _LEG) / 2
    leg = box((_LEG, _LEG, height))
    return together([leg.placed((sx * x, sy * y, 0.0)) for sx in (-1, 1) for sy in (-1, 1)])
