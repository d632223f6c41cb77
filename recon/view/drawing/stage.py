"""The stage: the floor, the lamp, and the shadows that figures cast."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float

from recon.core.geometry.raster import rasterise
from recon.core.ground import Ground, tangent_basis
from recon.view.show.viewpoint import Viewpoint

SKY = np.array([246.0, 247.5, 250.0])
TILES = np.array([[231.0, 233.0, 237.0], [219.0, 222.0, 228.0]])
TILE = 0.5
"""Side of a floor tile, metres."""
FADE = 4.2
"""Distance from the person, in metres, over which the floor fades into the sky."""
FADE_SHARE = 0.35
"""Share of the distance to what is looked at over which the floor fades, where that is more."""
FLOOR_SLACK = 0.004
"""Depth, in metres, up to which a sole may sink before the floor hides it."""
SHADOW_MAP = 640


@dataclass(frozen=True)
class Light:
    """Parallel light from the upper left of the viewer, with what it reaches first."""

    axes: Float[np.ndarray, "3 3"]
    """Rows: across and down in the light's picture, and toward the light."""
    centre: Float[np.ndarray, "3"]
    scale: float
    """Pixels of the light's picture per metre."""
    first: Float[np.ndarray, "side side"]
    """Nearness to the light of the first surface; -inf where the floor is first."""
    soft: Float[np.ndarray, "side side"]
    """Share of the light kept from the floor."""

    def place(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Pixel in the light's picture, and nearness to the light in metres."""
        local = (points - self.centre) @ self.axes.T
        local[..., :2] = local[..., :2] * self.scale + SHADOW_MAP / 2
        return local


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


def cast(surfaces: list[tuple[np.ndarray, np.ndarray]], plane: Plane, view: Viewpoint) -> Light:
    """The lamp above the viewer's left shoulder, and what surfaces keep from the floor."""
    right, _, forward = view.R_camera_world
    level = np.array([-forward[0], -forward[1], 0.0])
    toward = 0.75 * level / np.linalg.norm(level) - 0.65 * right + np.array([0, 0, 1.1])
    toward /= np.linalg.norm(toward)
    across = np.cross(toward, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(across, toward), toward])
    vertices = np.concatenate([v for v, _ in surfaces])
    centre = (vertices.min(0) + vertices.max(0)) / 2
    reach = np.abs((vertices - centre) @ axes[:2].T).max() + 0.35
    light = Light(axes, centre, SHADOW_MAP / (2 * reach), np.empty((0, 0)), np.empty((0, 0)))
    first = np.full((SHADOW_MAP, SHADOW_MAP), -np.inf)
    for surface, faces in surfaces:
        placed = light.place(surface)
        raster = rasterise(placed[:, :2], placed[:, 2], faces, (SHADOW_MAP, SHADOW_MAP))
        first = np.maximum(first, raster.nearness)

    # Penumbrae widen with the occluder's height: a sharp layer for what is close to the floor.
    side = (np.arange(SHADOW_MAP) + 0.5 - SHADOW_MAP / 2) / light.scale
    lit = np.isfinite(first)
    rise = axes @ plane.normal
    height = centre @ plane.normal - plane.offset + side[None] * rise[0] + side[:, None] * rise[1]
    height = height + np.where(lit, first, 0) * rise[2]
    layers = [
        cv2.GaussianBlur((lit & (height < limit)).astype(np.float32), (0, 0), blur * light.scale)
        for limit, blur in ((0.25, 0.012), (0.8, 0.03), (np.inf, 0.06))
    ]
    return Light(axes, centre, light.scale, first, np.maximum.reduce(layers))


def floor(plane: Plane, view: Viewpoint, light: Light) -> tuple[np.ndarray, np.ndarray]:
    """Picture of the floor alone and its nearness, a little below the ground."""
    width, height = view.size
    x = ((np.arange(width) + 0.5 - width / 2) / view.focal)[None].astype(np.float32)
    y = ((np.arange(height) + 0.5 - height / 2) / view.focal)[:, None].astype(np.float32)
    above = float(view.position @ plane.normal - plane.offset)
    fall = -_along(view.R_camera_world @ plane.normal, x, y)
    below = (fall > 1e-4) & (above > 0)
    depth = np.where(below, np.float32(above) / np.where(below, fall, 1), np.float32(0))

    def coordinate(axis: Float[np.ndarray, "3"], start: float) -> Float[np.ndarray, "_ _"]:
        """Start + axis · x of the floor's points, single precision."""
        shift = np.float32(start + view.position @ axis)
        return shift + depth * _along(view.R_camera_world @ axis, x, y)

    origin = light.place(np.zeros((1, 3)))[0]
    across, along = (
        coordinate(axis * light.scale, shift - 0.5)
        for axis, shift in zip(light.axes[:2], origin[:2], strict=True)
    )
    shadow = cv2.remap(light.soft, across, along, cv2.INTER_LINEAR, borderValue=0)
    first, second = (coordinate(axis, 0.0) for axis in plane.tiles.T)
    tile = np.floor(first / np.float32(TILE)) + np.floor(second / np.float32(TILE))
    odd = tile - 2 * np.floor(tile / 2)
    middle = (view.target @ plane.tiles).astype(np.float32)
    square = (first - middle[0]) ** 2 + (second - middle[1]) ** 2
    reach = max(FADE, FADE_SHARE * float(np.linalg.norm(view.target - view.position)))
    fade = np.exp(-square / np.float32(reach**2)) * below
    dim = 1 - np.float32(0.42) * shadow
    image = np.empty((height, width, 3), np.float32)
    for k in range(3):
        light_tile, dark_tile, sky = (np.float32(c[k]) for c in (*TILES, SKY))
        tiles = (light_tile + (dark_tile - light_tile) * odd) * dim
        image[..., k] = sky + fade * (tiles - sky)
    return image, np.where(below, fall / np.float32(max(above, 0) + FLOOR_SLACK), 0.0)


def _along(
    axis: Float[np.ndarray, "3"], x: Float[np.ndarray, "1 width"], y: Float[np.ndarray, "height 1"]
) -> Float[np.ndarray, "height width"]:
    """An axis, in the camera's frame, times the rays through all pixels."""
    right, down, forward = axis.astype(np.float32)
    return right * x + (down * y + forward)
