"""One picture of one frame: smooth shading, soft shadows, a checker floor, spheres for points."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.view.raster import Raster, rasterise, vertex_normals
from recon.view.scene import CLOUD, CONTACT, MISSING, VISIBLE, Colour, Figure, Show
from recon.view.viewpoint import Viewpoint

SUPERSAMPLING = 2
SKY = np.array([246.0, 247.5, 250.0])
TILES = np.array([[231.0, 233.0, 237.0], [219.0, 222.0, 228.0]])
TILE = 0.5
"""Side of a floor tile, metres."""
FADE = 4.2
"""Distance from the person, in metres, over which the floor fades into the sky."""
FLOOR_SLACK = 0.004
"""Depth, in metres, up to which a sole may sink before the floor hides it."""
SHADOW_MAP = 640
CLOUD_LIMIT = 3000
"""Points of a scan drawn per frame."""


@dataclass(frozen=True)
class _Light:
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


def paint(show: Show, frame: int, view: Viewpoint) -> UInt8[np.ndarray, "height width 3"]:
    """The show at one frame, red green blue."""
    fine = view.scaled(SUPERSAMPLING)
    surfaces = [
        (figure, figure.posed.vertices[frame].double().numpy(), figure.body.faces.cpu().numpy())
        for figure in show.figures
    ]
    light = _cast([(vertices, faces) for _, vertices, faces in surfaces], fine)
    image, nearness = _floor(fine, light)
    for figure, vertices, faces in sorted(surfaces, key=lambda row: -row[0].opacity):
        pixels, depth = fine.project(vertices)
        if depth.min() <= 0.05:
            continue  # the camera stands inside this body
        raster = rasterise(pixels, 1 / depth, faces, fine.size)
        front = raster.nearness > nearness
        shade = _shade(raster, front, vertices, faces, _tint(figure, frame), fine, light)
        image[front] += figure.opacity * (shade - image[front])
        if figure.opacity == 1:
            nearness = np.where(front, raster.nearness, nearness)
    _draw(_balls(show, frame), image, nearness, fine)
    small = cv2.resize(image, view.size, interpolation=cv2.INTER_AREA)
    return np.clip(small + 0.5, 0, 255).astype(np.uint8)


def _cast(surfaces: list[tuple[np.ndarray, np.ndarray]], view: Viewpoint) -> _Light:
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
    light = _Light(axes, centre, SHADOW_MAP / (2 * reach), np.empty((0, 0)), np.empty((0, 0)))
    first = np.full((SHADOW_MAP, SHADOW_MAP), -np.inf)
    for surface, faces in surfaces:
        placed = light.place(surface)
        raster = rasterise(placed[:, :2], placed[:, 2], faces, (SHADOW_MAP, SHADOW_MAP))
        first = np.maximum(first, raster.nearness)

    # Penumbrae widen with the occluder's height: a sharp layer for what is close to the floor.
    side = (np.arange(SHADOW_MAP) + 0.5 - SHADOW_MAP / 2) / light.scale
    lit = np.isfinite(first)
    height = (
        centre[2]
        + side[None, :] * axes[0, 2]
        + side[:, None] * axes[1, 2]
        + np.where(lit, first, 0) * axes[2, 2]
    )
    layers = [
        cv2.GaussianBlur((lit & (height < limit)).astype(np.float32), (0, 0), blur * light.scale)
        for limit, blur in ((0.25, 0.012), (0.8, 0.03), (np.inf, 0.06))
    ]
    return _Light(axes, centre, light.scale, first, np.maximum.reduce(layers))


def _floor(view: Viewpoint, light: _Light) -> tuple[np.ndarray, np.ndarray]:
    """Picture of the floor alone and its nearness, a little below the plane z = 0.

    The camera never rolls, so a row of the picture has one depth on the floor.
    """
    width, height = view.size
    right, down, forward = view.R_camera_world
    x = ((np.arange(width) + 0.5 - width / 2) / view.focal)[None].astype(np.float32)
    y = ((np.arange(height) + 0.5 - height / 2) / view.focal)[:, None]
    fall = -(y * down[2] + forward[2])
    below = (fall > 1e-4) & (view.position[2] > 0)
    depth = np.where(below, view.position[2] / np.where(below, fall, 1.0), 0.0)
    start = view.position + depth * (y * down + forward)
    ground = [
        start[:, k, None].astype(np.float32) + (depth * right[k]).astype(np.float32) * x
        for k in (0, 1)
    ]
    origin = light.place(np.zeros((1, 3)))[0]
    across, along = (
        np.float32(axis[0] * light.scale) * ground[0]
        + np.float32(axis[1] * light.scale) * ground[1]
        + np.float32(shift - 0.5)
        for axis, shift in zip(light.axes[:2], origin[:2], strict=True)
    )
    shadow = cv2.remap(light.soft, across, along, cv2.INTER_LINEAR, borderValue=0)
    tile = np.floor(ground[0] / np.float32(TILE)) + np.floor(ground[1] / np.float32(TILE))
    odd = tile - 2 * np.floor(tile / 2)
    square = (ground[0] - np.float32(view.target[0])) ** 2
    square += (ground[1] - np.float32(view.target[1])) ** 2
    fade = np.exp(-square / np.float32(FADE**2)) * below.astype(np.float32)
    dim = 1 - np.float32(0.42) * shadow
    image = np.empty((height, width, 3), np.float32)
    for k in range(3):
        light_tile, dark_tile, sky = (np.float32(c[k]) for c in (*TILES, SKY))
        tiles = (light_tile + (dark_tile - light_tile) * odd) * dim
        image[..., k] = sky + fade * (tiles - sky)
    nearness = np.where(below, fall / (view.position[2] + FLOOR_SLACK), 0.0)
    return image, np.repeat(nearness, width, 1)


def _tint(figure: Figure, frame: int) -> Float[np.ndarray, "vertices 3"]:
    """Colour of every vertex: its figure's, turning to `CONTACT` around joints that touch."""
    touching = figure.touching[frame].to(figure.body.weights)
    share = (figure.body.weights @ touching).double().numpy()[:, None]
    return _linear(figure.colour) * (1 - share) + _linear(CONTACT) * share


def _shade(
    raster: Raster,
    front: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    tint: np.ndarray,
    view: Viewpoint,
    light: _Light,
) -> Float[np.ndarray, "pixels 3"]:
    """Colour of the pixels in `front`: sky and floor light, the lamp with its shadow, a gloss."""
    corners, weights = faces[raster.face[front]], raster.barycentric[front][..., None]
    normals = (vertex_normals(vertices, faces)[corners] * weights).sum(1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colour = (tint[corners] * weights).sum(1)
    row, column = np.nonzero(front)
    rays = view.rays(np.stack([column, row], 1) + 0.5)
    points = view.position + rays / raster.nearness[front][:, None]
    eye = -rays / np.linalg.norm(rays, axis=1, keepdims=True)
    toward = light.axes[2]

    placed = light.place(points + 0.012 * normals)
    column, row = (np.floor(placed[:, k]).astype(np.int64) for k in (0, 1))
    reached = np.zeros(len(points))
    for dx in (-2, 0, 2):
        for dy in (-2, 0, 2):
            y = np.clip(row + dy, 0, SHADOW_MAP - 1)
            x = np.clip(column + dx, 0, SHADOW_MAP - 1)
            reached += light.first[y, x] < placed[:, 2] + 0.012
    lamp = np.clip(normals @ toward, 0, 1) * reached / 9
    ambient = 0.37 + 0.15 * normals[:, 2]
    halfway = eye + toward
    halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
    gloss = 0.10 * np.clip((normals * halfway).sum(1), 0, 1) ** 28 * reached / 9
    rim = 0.10 * (1 - np.clip((normals * eye).sum(1), 0, 1)) ** 3
    linear = colour * (ambient + 0.95 * lamp + rim)[:, None] + gloss[:, None]
    return _display(linear)


@dataclass(frozen=True)
class _Ball:
    """A sphere to be drawn."""

    centre: Float[np.ndarray, "3"]
    radius: float
    colour: Colour
    through: float
    """Opacity where a surface lies before it."""


def _balls(show: Show, frame: int) -> list[_Ball]:
    """Scan and points of a frame; points often lie inside the body, and shine through it."""
    balls: list[_Ball] = []
    if show.cloud is not None:
        cloud = show.cloud[frame].detach().cpu().double().numpy()
        step = max(1, -(-len(cloud) // CLOUD_LIMIT))
        balls += [_Ball(centre, 0.006, CLOUD, 0.12) for centre in cloud[::step]]
    if show.points is not None:
        radius, seen = show.points.radius, show.points.visible[frame].cpu().numpy()
        positions = show.points.positions[frame].detach().cpu().double().numpy()
        balls += [_Ball(centre, radius, VISIBLE, 0.62) for centre in positions[seen]]
        if show.points.estimated is not None:
            estimated = show.points.estimated[frame].detach().cpu().double().numpy()
            balls += [_Ball(centre, radius, MISSING, 0.62) for centre in estimated[~seen]]
    return balls


def _draw(balls: list[_Ball], image: np.ndarray, nearness: np.ndarray, view: Viewpoint) -> None:
    """Draw spheres over the picture, the far ones first."""
    if len(balls) == 0:
        return
    pixels, depth = view.project(np.stack([ball.centre for ball in balls]))
    for k in np.argsort(-depth):
        if depth[k] > 0.05:
            _draw_ball(balls[k], pixels[k], float(depth[k]), image, nearness, view.focal)


def _draw_ball(
    ball: _Ball,
    centre: np.ndarray,
    depth: float,
    image: np.ndarray,
    nearness: np.ndarray,
    focal: float,
) -> None:
    height, width = nearness.shape
    reach = max(ball.radius * focal / depth, 1.5)
    left, top = np.clip(np.floor(centre - reach), 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(centre + reach) + 1, 0, (width, height)).astype(int)
    x = (np.arange(left, right) + 0.5 - centre[0]) / reach
    y = (np.arange(top, bottom) + 0.5 - centre[1]) / reach
    square = x[None] ** 2 + y[:, None] ** 2
    bulge = np.sqrt(np.maximum(1 - square, 0))
    hidden = nearness[top:bottom, left:right] > 1 / (depth - ball.radius * bulge)
    lamp = np.clip(0.75 * bulge - 0.35 * x[None] - 0.45 * y[:, None], 0, 1)
    shaded = _display(_linear(ball.colour) * (0.45 + 0.7 * lamp)[..., None])
    cover = np.where(square < 1, np.where(hidden, ball.through, 1.0), 0.0)[..., None]
    patch = image[top:bottom, left:right]
    patch += cover * (shaded - patch)


def _linear(colour: Colour) -> Float[np.ndarray, "3"]:
    return (np.array(colour) / 255) ** 2.2


def _display(linear: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    return 255 * np.clip(linear, 0, 1) ** (1 / 2.2)
