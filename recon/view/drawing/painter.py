"""One picture of one frame: smooth shading, soft shadows, a checker floor, spheres for points."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.view.drawing.frusta import draw_lines, frustum
from recon.view.drawing.shading import Mesh, display, linear, paint_figure
from recon.view.drawing.stage import SUPERSAMPLING, Plane, cast, floor, nearness
from recon.view.show.colours import CAMERA, CERTAINTY, CLOUD, MISSING, VISIBLE, Colour
from recon.view.show.scene import Show
from recon.view.show.viewpoint import Viewpoint

CLOUD_LIMIT = 3000
"""Points of a scan drawn per frame."""
_HALO = 0.4
"""Opacity of the spheres that show standard deviations: the body is seen through them."""
CLOSEST = 0.05
"""Metres before the viewer from which on things are drawn."""


def paint(show: Show, frame: int, view: Viewpoint) -> UInt8[np.ndarray, "height width 3"]:
    """The show at one frame, red green blue."""
    surfaces = [
        (figure, figure.posed.vertices[frame].double().numpy(), figure.body.faces.cpu().numpy())
        for figure in show.figures
    ]
    plane = Plane.of(show.ground)
    light = cast([(vertices, faces) for _, vertices, faces in surfaces], plane, view)
    picture = floor(plane, view, light)
    balls = _balls(show, frame)
    frusta = [frustum(camera.at(frame)) for camera in show.cameras]
    ends = [points for _, points, _ in surfaces]
    ends += [np.stack([ball.centre for ball in balls])] if balls else []
    ends += [lines.reshape(-1, 3) for lines in frusta]
    room = max((ball.radius for ball in balls), default=0.0)
    left, top, right, bottom = _around(np.concatenate(ends), room, view)
    if right <= left or bottom <= top:
        return cv2.convertScaleAbs(picture)

    # Only what is drawn on the floor needs the finer pixels.
    fine = view.part(left, top, right, bottom).scaled(SUPERSAMPLING)
    beneath = picture[top:bottom, left:right]
    image = cv2.resize(beneath, fine.size, interpolation=cv2.INTER_NEAREST)
    near = nearness(plane, fine)
    for figure, vertices, faces in sorted(surfaces, key=lambda row: -row[0].opacity):
        pixels, depth = fine.project(vertices)
        if depth.min() > CLOSEST:  # else the camera stands inside this body
            mesh = Mesh(vertices, faces, pixels, depth)
            paint_figure(mesh, figure, frame, image, near, fine, light)
    _draw(balls, image, near, fine)
    for lines in frusta:
        draw_lines(lines, CAMERA, image, near, fine, SUPERSAMPLING)
    size = (right - left, bottom - top)
    picture[top:bottom, left:right] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return cv2.convertScaleAbs(picture)


def _around(
    points: Float[np.ndarray, "points 3"], radius: float, view: Viewpoint
) -> tuple[int, int, int, int]:
    """The part of a picture that spheres are in: left, top, right, bottom.

    It is the whole picture where a centre is not well before the viewer.
    """
    pixels, depth = view.project(points)
    if depth.min() <= CLOSEST:
        return 0, 0, *view.size
    reach = radius * view.focal / depth[:, None] + 2
    left, top = np.clip(np.floor((pixels - reach).min(0)), 0, view.size).astype(int).tolist()
    right, bottom = np.clip(np.ceil((pixels + reach).max(0)), 0, view.size).astype(int).tolist()
    return left, top, right, bottom


@dataclass(frozen=True)
class _Ball:
    """A sphere to be drawn."""

    centre: Float[np.ndarray, "3"]
    radius: float
    colour: Colour
    through: float
    """Opacity where a surface lies before it."""
    front: float = 1.0
    """Opacity where nothing lies before it."""


def _balls(show: Show, frame: int) -> list[_Ball]:
    """Scan and points of a frame; points often lie inside the body, and shine through it."""
    balls = _halos(show, frame) if show.certainty else []
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


def _halos(show: Show, frame: int) -> list[_Ball]:
    """Spheres of one standard deviation around the joints of figures."""
    return [
        _Ball(centre.numpy(), float(radius), CERTAINTY, _HALO, _HALO)
        for figure in show.figures
        if figure.joint_std is not None
        for centre, radius in zip(
            figure.posed.joints[frame].double(), figure.joint_std[frame].cpu(), strict=True
        )
    ]


def _draw(balls: list[_Ball], image: np.ndarray, nearness: np.ndarray, view: Viewpoint) -> None:
    """Draw spheres over the picture, the far ones first."""
    if len(balls) == 0:
        return
    pixels, depth = view.project(np.stack([ball.centre for ball in balls]))
    for k in np.argsort(-depth):
        if depth[k] > CLOSEST:
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
    if right <= left or bottom <= top:
        return
    x = (np.arange(left, right) + 0.5 - centre[0]) / reach
    y = (np.arange(top, bottom) + 0.5 - centre[1]) / reach
    square = x[None] ** 2 + y[:, None] ** 2
    bulge = np.sqrt(np.maximum(1 - square, 0))
    hidden = nearness[top:bottom, left:right] > 1 / (depth - ball.radius * bulge)
    lamp = np.clip(0.75 * bulge - 0.35 * x[None] - 0.45 * y[:, None], 0, 1)
    shaded = display(linear(ball.colour) * (0.45 + 0.7 * lamp)[..., None])
    cover = np.where(square < 1, np.where(hidden, ball.through, ball.front), 0.0)[..., None]
    patch = image[top:bottom, left:right]
    patch += cover * (shaded - patch)
