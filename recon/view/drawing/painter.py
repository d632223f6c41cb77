"""One picture of one frame: smooth shading, soft shadows, a checker floor, spheres for points."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from recon.core.raster import Raster, rasterise, vertex_normals
from recon.view.drawing.stage import (
    SHADOW_MAP,
    SUPERSAMPLING,
    Light,
    Plane,
    cast,
    draw_lines,
    floor,
    frustum,
    nearness,
    strips,
)
from recon.view.scene import (
    CAMERA,
    CERTAINTY,
    CLOUD,
    CONTACT,
    MISSING,
    VISIBLE,
    Colour,
    Figure,
    Show,
)
from recon.view.viewpoint import Viewpoint

DIRECT = 0.95
"""Light of the lamp on a surface that faces it; 1 shows a colour as it is."""
SELF_SHADOW = 0.012
"""Metres that a surface is lifted before something can shade it."""
DARKEST = 1e-6
"""Light that shows as black; OpenCV takes ten times as long over the power of zero."""
SOFTNESS = (-2, 0, 2)
"""Pixels of the light's picture beside a point, each way, that decide how far it is shaded."""


@dataclass(frozen=True)
class Mesh:
    """A surface in the world, and where the viewer sees it."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    pixels: Float[np.ndarray, "vertices 2"]
    depth: Float[np.ndarray, " vertices"]
    """Metres, all positive."""


def paint_figure(
    mesh: Mesh,
    figure: Figure,
    frame: int,
    image: Float[np.ndarray, "height width 3"],
    near: Float[np.ndarray, "height width"],
    view: Viewpoint,
    light: Light,
) -> None:
    """Paint a body over a picture, where it is nearer than what `near` says.

    `near` is one over the depth; a solid body changes it, a translucent one does not.
    """
    width, height = view.size
    shades = _shades(mesh, view, light)
    raster = rasterise(mesh.pixels, mesh.depth, mesh.faces, view.size, shades)
    contact = _contact(mesh, figure, frame, raster)
    colour = linear(figure.colour)
    mixture = np.column_stack([colour, linear(CONTACT) - colour, np.ones(3)])
    for rows in strips(height):
        nearness = 1 / raster.depth[rows]
        front = nearness > near[rows]
        ambient, lamp, gloss = cv2.split(raster.values[rows])
        part = view.part(0, rows.start, width, rows.stop)
        reached = _reached(raster.depth[rows], lamp, front & (lamp > 0), part, light)
        amount = ambient + DIRECT * lamp * reached
        # The figure's colour, its turning to the contacts' colour, and the gloss, which is white.
        turned = amount * contact[rows]
        painted = display(cv2.transform(cv2.merge([amount, turned, gloss * reached]), mixture))
        if figure.opacity == 1:
            np.copyto(near[rows], nearness, where=front)
        else:
            share = figure.opacity
            painted = cv2.addWeighted(painted, share, image[rows], 1 - share, 0)
        cv2.copyTo(painted, front.view(np.uint8), image[rows])


def contact_shares(figure: Figure, frame: int) -> Float[np.ndarray, " vertices"]:
    """How far every vertex turns to the colour of contacts: around joints that touch."""
    touching = figure.touching[frame].to(figure.body.weights)
    return (figure.body.weights @ touching).double().numpy()


def _shades(mesh: Mesh, view: Viewpoint, light: Light) -> Float[np.ndarray, "vertices 3"]:
    """Light at every vertex: from sky and floor, from the lamp before shadows, and the gloss."""
    normals = vertex_normals(mesh.vertices, mesh.faces)
    eye = view.position - mesh.vertices
    eye /= np.linalg.norm(eye, axis=1, keepdims=True)
    toward = light.axes[2]
    halfway = eye + toward
    halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
    rim = 0.10 * (1 - np.clip((normals * eye).sum(1), 0, 1)) ** 3
    ambient = 0.37 + 0.15 * normals[:, 2] + rim
    gloss = 0.10 * np.clip((normals * halfway).sum(1), 0, 1) ** 28
    return np.stack([ambient, np.clip(normals @ toward, 0, 1), gloss], 1)


def _reached(
    depth: Float[np.ndarray, "height width"],
    lamp: Float[np.ndarray, "height width"],
    asked: Bool[np.ndarray, "height width"],
    view: Viewpoint,
    light: Light,
) -> Float[np.ndarray, "height width"]:
    """Share of the lamp's light that reaches the pixels asked for; 0 at the others."""
    height, width = depth.shape
    columns, rows = (np.arange(count, dtype=np.float32) for count in (width, height))
    distance = depth[asked]
    placed: list[np.ndarray] = []
    for axis, start, scale in zip(
        light.axes, light.place(view.position), (light.scale, light.scale, 1.0), strict=True
    ):
        x, y, rest = (scale * view.along(axis)).astype(np.float32)
        ray = x * columns + (y * rows + rest)[:, None]
        placed.append(np.float32(start) + distance * ray[asked])
    edge = -SOFTNESS[0]
    column, row = (
        np.clip(along, edge, SHADOW_MAP - 1 - edge).astype(np.int32) for along in placed[:2]
    )
    # The more slanted a surface, the farther its neighbours in the light's picture are from it.
    slant = np.maximum(lamp[asked], 0.1)
    level = placed[2] + np.float32(SELF_SHADOW) * (1 + 1 / slant)

    first, pixel = light.first.ravel(), row * SHADOW_MAP + column
    free = np.zeros(len(pixel), np.float32)
    for down in SOFTNESS:
        for across in SOFTNESS:
            free += np.take(first, pixel + (down * SHADOW_MAP + across)) < level
    reached = np.zeros_like(depth)
    reached[asked] = free / len(SOFTNESS) ** 2
    return reached


def _contact(
    mesh: Mesh, figure: Figure, frame: int, seen: Raster
) -> Float[np.ndarray, "height width"]:
    """How far every pixel turns to the colour of contacts."""
    height, width = seen.depth.shape
    if not bool(figure.touching[frame].any()):
        return np.zeros((height, width), np.float32)
    shares = contact_shares(figure, frame)
    faces = mesh.faces[(shares[mesh.faces] > 0.01).any(1)]
    values = np.column_stack([shares, shares, shares])
    part = rasterise(mesh.pixels, mesh.depth, faces, (width, height), values)
    return np.where(part.depth <= seen.depth + 0.002, part.values[..., 0], np.float32(0))


def linear(colour: Colour) -> Float[np.ndarray, "3"]:
    """A colour as amounts of light, 0 to 1."""
    return (np.array(colour) / 255) ** 2.2


def display(light: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Amounts of light as red, green and blue, 0 to 255."""
    return 255 * cv2.pow(np.clip(light, DARKEST, 1), 1 / 2.2)


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
