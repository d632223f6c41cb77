"""The stage: the floor, the lamp above it, and the shadows that bodies cast."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view

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
SHADOW_SIDE_PX = 640
"""Pixels along each side of the lamp's picture; half as many hold the soft shadow."""
LAMP_M = 100.0
"""Least distance at which the lamp is drawn, metres: a body's depths differ by a fiftieth."""
SELF_SHADOW_M = 0.012
"""Height, metres, that a surface is lifted before something can shade it."""
SOFTNESS_PX = 3
"""Pixels of the lamp's picture beside a point, each way, that decide how far it is shaded."""
SHADE = 0.42
"""Share of the floor's light that a full shadow takes."""
PENUMBRAE_M = ((0.25, 0.012), (0.8, 0.03), (np.inf, 0.06))
"""Heights up to which bodies shade the floor with these blurs, metres: low parts shade sharply."""

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


@dataclass(frozen=True)
class Lamp:
    """Parallel light from the upper left of the viewer, with what it reaches first."""

    axes: Float[np.ndarray, "3 3"]
    """Rows: across and down in the lamp's picture, and toward the lamp."""
    centre: Float[np.ndarray, "3"]
    """Middle of the lamp's picture in the world, metres."""
    scale: float
    """Pixels of the lamp's picture per metre."""
    first: Float[np.ndarray, "side side"]
    """Metres toward the lamp, from the centre, of the first surface; -inf where none is."""
    soft: Float[np.ndarray, "half half"]
    """Share of the light that is kept from the floor, at half the resolution."""

    @classmethod
    def over(cls, bodies: list[Mesh], plane: Plane, view: Viewpoint) -> "Lamp":
        """The lamp above the viewer's left shoulder, and what bodies keep from the floor."""
        right, _, forward = view.R_camera_world
        level = np.array([-forward[0], -forward[1], 0.0])
        toward = 0.75 * level / np.linalg.norm(level) - 0.65 * right + np.array([0, 0, 1.1])
        toward /= np.linalg.norm(toward)
        across = np.cross(toward, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(across, toward), toward])
        vertices = np.concatenate([vertices for vertices, _ in bodies])
        starts = np.cumsum([0, *(len(vertices) for vertices, _ in bodies)])
        faces = np.concatenate([f + start for (_, f), start in zip(bodies, starts, strict=False)])
        centre = (vertices.min(0) + vertices.max(0)) / 2
        local = (vertices - centre) @ axes.T
        side = SHADOW_SIDE_PX
        scale = side / (2 * (np.abs(local[:, :2]).max() + 0.35))
        distance = LAMP_M + float(np.abs(local[:, 2]).max())
        heights = np.tile((vertices @ plane.normal - plane.offset)[:, None], 3)
        pixels = local[:, :2] * scale + side / 2
        raster = rasterise(pixels, distance - local[:, 2], faces, (side, side), heights)
        layers: list[np.ndarray] = []
        for limit, blur in PENUMBRAE_M:
            kept = (raster.covered & (raster.values[..., 0] < limit)).astype(np.float32)
            kept = cv2.resize(kept, (side // 2, side // 2), interpolation=cv2.INTER_AREA)
            layers.append(cv2.GaussianBlur(kept, (0, 0), blur * scale / 2))
        return cls(axes, centre, scale, distance - raster.depth, np.maximum.reduce(layers))

    def reached(
        self, vertices: Float[np.ndarray, "vertices 3"], facing: Float[np.ndarray, " vertices"]
    ) -> Float[np.ndarray, " vertices"]:
        """Share of the light that reaches vertices of bodies.

        Args:
            vertices: world, metres.
            facing: cosines between normals and the lamp: the more slanted a surface, the farther
                its neighbours in the lamp's picture are from it.
        """
        local = (vertices - self.centre) @ self.axes.T
        corner = local[:, :2] * self.scale + SHADOW_SIDE_PX / 2 - SOFTNESS_PX
        windows = sliding_window_view(self.first, (2 * SOFTNESS_PX + 1,) * 2)
        column, row = np.clip(corner, 0, len(windows) - 1).astype(int).T
        level = local[:, 2] + SELF_SHADOW_M * (1 + 1 / np.maximum(facing, 0.1))
        return (windows[row, column] < level[:, None, None]).mean((1, 2))


def floor(plane: Plane, view: Viewpoint, lamp: Lamp) -> Float[np.ndarray, "height width 3"]:
    """Picture of the floor alone: tiles that fade into the sky, with the bodies' shadow."""
    fine = view.scaled(SUPERSAMPLING)
    number = np.floor(fine.seen(plane.tiles.T / TILE_M, plane.depth(fine))).astype(np.int32)
    odd = (number.sum(0) & 1).astype(np.float32)
    odd = cv2.resize(odd, view.size, interpolation=cv2.INTER_AREA)[..., None]
    axes = np.concatenate([plane.tiles.T, lamp.axes[:2]])
    places = view.seen(axes, plane.depth(view))
    places -= np.concatenate([view.target @ plane.tiles, lamp.axes[:2] @ lamp.centre])[
        :, None, None
    ]
    reach = max(FADE_M, FADE_SHARE * float(np.linalg.norm(view.target - view.position)))
    fade = np.exp(-np.square(places[:2] / reach).sum(0))[..., None]
    across, down = ((places[2:] * lamp.scale + SHADOW_SIDE_PX / 2) / 2 - 0.5).astype(np.float32)
    shade = 1 - SHADE * cv2.remap(lamp.soft, across, down, cv2.INTER_LINEAR)[..., None]
    tiles = TILES[0] + odd * (TILES[1] - TILES[0])
    return SKY + fade * (tiles * shade - SKY)
