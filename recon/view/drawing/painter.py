"""One picture of one frame: smooth shading, soft shadows, a checker floor, spheres for points."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.core.geometry.normals import vertex_normals
from recon.core.geometry.raster import Raster, rasterise
from recon.view.drawing.frusta import draw_lines, frustum
from recon.view.drawing.stage import SHADOW_MAP, Light, Plane, cast, floor
from recon.view.show.colours import CAMERA, CLOUD, CONTACT, MISSING, VISIBLE, Colour
from recon.view.show.scene import Figure, Show
from recon.view.show.viewpoint import Viewpoint

SUPERSAMPLING = 2
CLOUD_LIMIT = 3000
"""Points of a scan drawn per frame."""


def paint(show: Show, frame: int, view: Viewpoint) -> UInt8[np.ndarray, "height width 3"]:
    """The show at one frame, red green blue."""
    fine = view.scaled(SUPERSAMPLING)
    surfaces = [
        (figure, figure.posed.vertices[frame].double().numpy(), figure.body.faces.cpu().numpy())
        for figure in show.figures
    ]
    plane = Plane.of(show.ground)
    light = cast([(vertices, faces) for _, vertices, faces in surfaces], plane, fine)
    image, nearness = floor(plane, fine, light)
    for figure, vertices, faces in sorted(surfaces, key=lambda row: -row[0].opacity):
        pixels, depth = fine.project(vertices)
        if depth.min() <= 0.05:
            continue  # the camera stands inside this body
        raster = rasterise(pixels, 1 / depth, faces, fine.size)
        front = raster.nearness > nearness
        shade = _shade(raster, front, vertices, faces, tint(figure, frame), fine, light)
        image[front] += figure.opacity * (shade - image[front])
        if figure.opacity == 1:
            nearness = np.where(front, raster.nearness, nearness)
    _draw(_balls(show, frame), image, nearness, fine)
    for camera in show.cameras:
        lines = frustum(camera.at(frame))
        draw_lines(lines, CAMERA, image, nearness, fine, SUPERSAMPLING)
    small = cv2.resize(image, view.size, interpolation=cv2.INTER_AREA)
    return np.clip(small + 0.5, 0, 255).astype(np.uint8)


def tint(figure: Figure, frame: int) -> Float[np.ndarray, "vertices 3"]:
    """Colour of every vertex: its figure's, turning to `CONTACT` around joints that touch."""
    touching = figure.touching[frame].to(figure.body.weights)
    share = (figure.body.weights @ touching).double().numpy()[:, None]
    return linear(figure.colour) * (1 - share) + linear(CONTACT) * share


def _shade(
    raster: Raster,
    front: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    tint: np.ndarray,
    view: Viewpoint,
    light: Light,
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
    reflected = colour * (ambient + 0.95 * lamp + rim)[:, None] + gloss[:, None]
    return display(reflected)


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
    shaded = display(linear(ball.colour) * (0.45 + 0.7 * lamp)[..., None])
    cover = np.where(square < 1, np.where(hidden, ball.through, 1.0), 0.0)[..., None]
    patch = image[top:bottom, left:right]
    patch += cover * (shaded - patch)


def linear(colour: Colour) -> Float[np.ndarray, "3"]:
    """A colour as amounts of light, 0 to 1."""
    return (np.array(colour) / 255) ** 2.2


def display(light: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Amounts of light as red, green and blue, 0 to 255."""
    return 255 * np.clip(light, 0, 1) ** (1 / 2.2)
