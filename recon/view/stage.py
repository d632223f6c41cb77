"""The stage: the floor, the lamp above it, and the shadows that bodies cast on the floor."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int

from recon.core.camera import Ground, tangent_basis
from recon.core.raster import rasterise
from recon.view.viewpoint import Viewpoint

SUPERSAMPLING = 2
"""Pixels along each side of a picture's pixel, where edges of bodies and tiles are smoothed."""
SKY = np.array([246.0, 247.5, 250.0], np.float32)
TILES = np.array([[231.0, 233.0, 237.0], [219.0, 222.0, 228.0]], np.float32)
TILE_M = 0.5
"""Side of a floor tile, metres."""
FADE_M = 4.2
"""Distance from the person, metres, over which the floor fades into the sky."""
FADE_SHARE = 0.35
"""Share of the distance to what is looked at over which the floor fades, where that is more."""
FARTHEST_M = 1e4
"""Depth that pixels above the horizon are given, metres."""
SHADE = 0.42
"""Share of the floor's light that a full shadow takes."""
PENUMBRA_M = 0.03
"""Width over which the edge of a shadow is blurred, metres."""
NEAREST_M = 0.05
"""Depth, metres, from which on things are drawn."""

Mesh = tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]
"""Vertices in the world, metres, and faces."""


@dataclass(frozen=True)
class Plane:
    """The floor: n·x = d with two directions along its tiles."""

    normal: Float[np.ndarray, "3"]
    offset: float
    tiles: Float[np.ndarray, "3 2"]

    @classmethod
    def of(cls, ground: Ground | None) -> "Plane":
        """A ground; None is z = 0."""
        if ground is None:
            ground = Ground(torch.tensor([0.0, 0.0, 1.0]), torch.tensor(0.0))
        ground = ground.detach().to(device="cpu", dtype=torch.float64)
        basis = tangent_basis(ground.normal)
        return cls(ground.normal.numpy(), float(ground.offset), basis.numpy())

    def depth(self, view: Viewpoint, sunk: float = 0.0) -> Float[np.ndarray, "height width"]:
        """Depth of the floor, metres, where it is `sunk` metres lower; far above the horizon."""
        above = float(view.position @ self.normal - self.offset) + sunk
        width, height = view.size
        unit = np.ones((height, width), np.float32)
        fall = above - view.seen(self.normal[None], unit)[0] + np.float32(self.offset - sunk)
        if above <= 0:
            return np.full_like(fall, FARTHEST_M)
        return above / np.maximum(fall, above / FARTHEST_M)


def lamp(view: Viewpoint) -> Float[np.ndarray, "3"]:
    """Unit vector toward a lamp far above the viewer's left shoulder."""
    right, _, forward = view.R_camera_world
    level = np.array([-forward[0], -forward[1], 0.0])
    toward = 0.75 * level / np.linalg.norm(level) - 0.65 * right + np.array([0, 0, 1.1])
    return toward / np.linalg.norm(toward)


def shadow(bodies: list[Mesh], plane: Plane, view: Viewpoint) -> Float[np.ndarray, "height width"]:
    """Share of the lamp's light that bodies keep from every pixel of the floor."""
    toward = lamp(view)
    dark = np.zeros(view.size[::-1], np.float32)
    for vertices, faces in bodies:
        along = (vertices @ plane.normal - plane.offset) / (toward @ plane.normal)
        pixels, depth = view.project(vertices - along[:, None] * toward)
        seen = faces[(depth > NEAREST_M)[faces].all(1)]
        dark = np.maximum(dark, rasterise(pixels, depth, seen, view.size).covered)
    away = float(np.linalg.norm(view.target - view.position))
    return cv2.GaussianBlur(dark, (0, 0), PENUMBRA_M * view.focal / away)


def floor(
    plane: Plane, view: Viewpoint, dark: Float[np.ndarray, "height width"]
) -> Float[np.ndarray, "height width 3"]:
    """Picture of the floor alone: tiles that fade into the sky, with the bodies' shadow."""
    fine = view.scaled(SUPERSAMPLING)
    number = np.floor(fine.seen(plane.tiles.T / TILE_M, plane.depth(fine))).astype(np.int32)
    odd = (number.sum(0) & 1).astype(np.float32)
    odd = cv2.resize(odd, view.size, interpolation=cv2.INTER_AREA)[..., None]
    places = view.seen(plane.tiles.T, plane.depth(view))
    places -= (view.target @ plane.tiles)[:, None, None]
    reach = max(FADE_M, FADE_SHARE * float(np.linalg.norm(view.target - view.position)))
    fade = np.exp(-np.square(places / reach).sum(0))[..., None]
    tiles = TILES[0] + odd * (TILES[1] - TILES[0])
    return SKY + fade * (tiles * (1 - SHADE * dark[..., None]) - SKY)
