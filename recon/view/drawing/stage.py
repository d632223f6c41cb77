"""The stage: the floor, the lamp, and the shadows that figures cast."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import torch
from jaxtyping import Float, Num, UInt8

from recon.core.camera import Camera, Ground, tangent_basis
from recon.core.raster import rasterise
from recon.view.scene import Colour
from recon.view.viewpoint import Viewpoint

SUPERSAMPLING = 2
"""Pixels along each side of a picture's pixel, where edges of bodies and tiles are smoothed."""
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
"""Pixels along each side of the light's picture; half as many hold the soft shadow."""
LAMP = 100.0
"""Least distance in metres at which the lamp is drawn: a body's depths differ by a fiftieth."""
SHADE = 0.42
"""Share of the floor's light that a full shadow takes."""
STRIP = 64
"""Rows that are painted at once."""
_PAIR = 512
"""Pixels along two tiles, in the picture of their pattern."""
_FADED = 3.0
"""Distances `FADE` after which the floor is the sky."""

Place = Float[np.ndarray, "2 4"]
"""Matrix that takes world points (x, y, z, 1) to the pixels of a flat image on the floor."""


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
    soft: Float[np.ndarray, "half half"]
    """Share of the light kept from the floor, at half the resolution."""

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
    starts = np.cumsum([0, *(len(v) for v, _ in surfaces)])
    faces = np.concatenate([f + start for (_, f), start in zip(surfaces, starts, strict=False)])
    centre = (vertices.min(0) + vertices.max(0)) / 2
    reach = np.abs((vertices - centre) @ axes[:2].T).max() + 0.35
    light = Light(axes, centre, SHADOW_MAP / (2 * reach), np.empty((0, 0)), np.empty((0, 0)))
    placed = light.place(vertices)
    lamp = LAMP + float(np.abs(placed[:, 2]).max())
    raster = rasterise(placed[:, :2], lamp - placed[:, 2], faces, (SHADOW_MAP, SHADOW_MAP))
    light = dataclasses.replace(light, first=np.float32(lamp) - raster.depth)
    return dataclasses.replace(light, soft=_softened(light, plane))


def _softened(light: Light, plane: Plane) -> Float[np.ndarray, "half half"]:
    """Penumbrae widen with the occluder's height: a sharp layer for what is near the floor."""
    side = ((np.arange(SHADOW_MAP) + 0.5 - SHADOW_MAP / 2) / light.scale).astype(np.float32)
    rise = (light.axes @ plane.normal).astype(np.float32)
    start = np.float32(light.centre @ plane.normal - plane.offset)
    lit = np.isfinite(light.first)
    height = np.where(lit, light.first, 0) * rise[2]
    height += start + side[None] * rise[0] + side[:, None] * rise[1]
    half = (SHADOW_MAP // 2, SHADOW_MAP // 2)
    layers: list[np.ndarray] = []
    for limit, blur in ((0.25, 0.012), (0.8, 0.03), (np.inf, 0.06)):
        kept = (lit & (height < limit)).astype(np.float32)
        kept = cv2.resize(kept, half, interpolation=cv2.INTER_AREA)
        layers.append(cv2.GaussianBlur(kept, (0, 0), blur * light.scale / 2))
    return np.maximum.reduce(layers)


def floor(plane: Plane, view: Viewpoint, light: Light) -> Float[np.ndarray, "height width 3"]:
    """Picture of the floor alone.

    The tiles, how they fade into the sky and the shadow are flat images on it, each of which one
    homography takes into the picture.
    """
    width, height = view.size
    middle = view.target @ plane.tiles
    reach = max(FADE, FADE_SHARE * float(np.linalg.norm(view.target - view.position)))
    # Pairs of tiles repeat; from the nearest pair on, pixels of the pattern are small numbers.
    nearby = 2 * TILE * np.floor(middle / (2 * TILE))
    tiles = np.column_stack([plane.tiles.T, -nearby]) * _PAIR / (2 * TILE)
    fading = (
        np.column_stack([plane.tiles.T, _FADED * reach - middle]) * _PAIR / (2 * _FADED * reach)
    )
    shadow = np.column_stack([light.axes[:2], -light.axes[:2] @ light.centre]) * light.scale
    shadow[:, 3] += SHADOW_MAP / 2
    places = (tiles, fading, shadow / 2)
    picture = np.empty((height, width, 3), np.float32)
    for rows in strips(height):
        part = view.part(0, rows.start, width, rows.stop)
        picture[rows] = _floor_strip(plane, part, light.soft, places)
    return picture


def _floor_strip(
    plane: Plane,
    view: Viewpoint,
    soft: Float[np.ndarray, "half half"],
    places: tuple[Place, Place, Place],
) -> Float[np.ndarray, "height width 3"]:
    tiles, fading, shadow = places
    fine = view.scaled(SUPERSAMPLING)
    odd = _on_floor(_pattern(), tiles, plane, fine, cv2.INTER_NEAREST, cv2.BORDER_WRAP)
    odd = cv2.resize(odd, view.size, interpolation=cv2.INTER_AREA)
    fade = _on_floor(_fading(), fading, plane, view, cv2.INTER_NEAREST)
    fade *= nearness(plane, view) > 0
    dim = fade * (1 - np.float32(SHADE) * _on_floor(soft, shadow, plane, view))
    odd = cv2.multiply(dim, odd, scale=1 / 255, dtype=cv2.CV_32F)
    # sky + fade · (tiles · dim - sky), where tiles lie between the two colours
    even, other = TILES
    mixture = np.column_stack([-SKY, even, other - even, SKY])
    return cv2.transform(cv2.merge([fade, dim, odd]), mixture)


def strips(height: int) -> Iterator[slice]:
    """Rows of a picture, a few at a time: memory of that size stays in the processor's caches."""
    return (slice(top, min(top + STRIP, height)) for top in range(0, height, STRIP))


def nearness(plane: Plane, view: Viewpoint) -> Float[np.ndarray, "height width"]:
    """One over the floor's depth, a little below the ground; 0 above the horizon."""
    width, height = view.size
    above = float(view.position @ plane.normal - plane.offset)
    x, y, start = (-view.along(plane.normal)).astype(np.float32)
    fall = x * np.arange(width, dtype=np.float32) + (
        y * np.arange(height, dtype=np.float32)[:, None] + start
    )
    below = (fall > 1e-4) & (above > 0)
    return np.where(below, fall / np.float32(max(above, 0) + FLOOR_SLACK), np.float32(0))


def _on_floor(
    flat: Num[np.ndarray, "rows columns"],
    place: Place,
    plane: Plane,
    view: Viewpoint,
    interpolation: int = cv2.INTER_LINEAR,
    border: int = cv2.BORDER_CONSTANT,
) -> Num[np.ndarray, "height width"]:
    """A flat image on the floor as the viewer sees it; mirrored above the horizon.

    The centre of the image's first pixel is at 0.5.
    """
    above = float(view.position @ plane.normal - plane.offset)
    fall = -view.along(plane.normal)
    axes = np.stack([view.along(axis) for axis in place[:, :3]])
    start = place[:, :3] @ view.position + place[:, 3] - 0.5
    homography = np.vstack([above * axes + start[:, None] * fall, fall])
    flags = interpolation | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(flat, homography, view.size, flags=flags, borderMode=border)


@lru_cache(maxsize=1)
def _pattern() -> UInt8[np.ndarray, "pair pair"]:
    """Two by two tiles: 255 on those of the other colour."""
    far = np.arange(_PAIR) >= _PAIR // 2
    return np.where(far[:, None] != far[None], np.uint8(255), np.uint8(0))


@lru_cache(maxsize=1)
def _fading() -> Float[np.ndarray, "pair pair"]:
    """How much is seen of the floor, around the middle up to `_FADED` times its reach."""
    side = ((np.arange(_PAIR) + 0.5) / _PAIR * 2 - 1) * _FADED
    bell = np.exp(-np.square(side)).astype(np.float32)
    return bell[:, None] * bell[None]


LENGTH = 0.4
"""Length of a drawn pyramid along the viewing axis, metres."""
PIECES = 24
"""Parts of a line that are hidden by surfaces on their own."""
THROUGH = 0.2
"""Opacity where a surface lies before a line."""


def frustum(camera: Camera) -> Float[np.ndarray, "8 2 3"]:
    """Edges of a camera's pyramid: from its centre to the image's corners, and round these.

    World, metres. The lens is left out: its inverse need not exist at the corners.
    """
    width, height = camera.image_size
    outline = [[0, 0], [width, 0], [width, height], [0, height]]
    pixels = torch.tensor(outline, dtype=torch.float64)
    straight = camera.detach().to(device="cpu", dtype=torch.float64).replace(distortion=None)
    corners = straight.unproject(pixels, torch.full((4,), LENGTH, dtype=torch.float64)).numpy()
    centre = np.broadcast_to(straight.T_world_camera[:3, 3].numpy(), (4, 3))
    rays, rim = np.stack([centre, corners], 1), np.stack([corners, np.roll(corners, -1, 0)], 1)
    return np.concatenate([rays, rim])


def draw_lines(
    lines: Float[np.ndarray, "lines 2 3"],
    colour: Colour,
    image: Float[np.ndarray, "height width 3"],
    nearness: Float[np.ndarray, "height width"],
    view: Viewpoint,
    thickness: int,
) -> None:
    """Draw lines of the world over a picture, faint where a surface is nearer."""
    shares = np.linspace(0, 1, PIECES + 1)[None, :, None]
    points = lines[:, :1] + shares * (lines[:, 1:] - lines[:, :1])
    pixels, depth = (part.reshape(len(lines), PIECES + 1, -1) for part in view.project(
        points.reshape(-1, 3)
    ))  # fmt: skip
    height, width = nearness.shape
    cover = np.zeros((height, width), np.uint8)
    for track, far in zip(pixels, depth[..., 0], strict=True):
        for k in range(PIECES):
            place = (track[k] + track[k + 1]) / 2
            inside = (place > -50).all() and place[0] < width + 50 and place[1] < height + 50
            if min(far[k], far[k + 1]) < 0.05 or not inside:
                continue
            x, y = np.clip(place, 0, (width - 1, height - 1)).astype(int)
            hidden = nearness[y, x] > 2 / (far[k] + far[k + 1])
            ends = [tuple(int(v) for v in np.round((end - 0.5) * 16)) for end in track[k : k + 2]]
            layer = round(255 * (THROUGH if hidden else 1.0))
            cv2.line(cover, ends[0], ends[1], layer, thickness, cv2.LINE_AA, shift=4)
    opacity = cover[..., None] / np.float32(255)
    image += opacity * (np.array(colour, np.float32) - image)
