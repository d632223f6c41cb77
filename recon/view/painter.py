"""Paints one frame of a scene: lit surfaces over a tiled floor, on the processor.

Bodies, points and cameras are all faces whose vertices have a light; whatever lies between them is
interpolated. Only the pixels around them are painted finely.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
import trimesh
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from recon.core.camera import Camera, Ground, tangent_basis
from recon.core.raster import rasterise, vertex_normals
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
    at_most_points,
)
from recon.view.viewpoint import Viewpoint

SUPERSAMPLING = 2
"""Number of finer pixels along a pixel's side, by which edges of bodies and tiles are smoothed."""
SKY = np.array([246.0, 247.5, 250.0], np.float32)
TILES = np.array([[231.0, 233.0, 237.0], [219.0, 222.0, 228.0]], np.float32)
TILE_M = 0.5
"""Side of a floor tile, metres."""
FADE_M = 4.2
"""Distance from the person, metres, over which the floor fades into the sky."""
FADE_SHARE = 0.35
"""Least distance over which the floor fades, as a share of the viewer's distance to the target."""
FARTHEST_M = 1e4
"""Depth of the floor at pixels above the horizon, metres."""
SHADE = 0.42
"""Share of the floor's light that a full shadow takes."""
PENUMBRA_M = 0.03
"""Width over which the edge of a shadow is blurred, metres."""
NEAREST_M = 0.05
"""Least depth of things that are drawn, metres."""

Mesh = tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]
"""Vertices in the world, metres, and faces."""


@dataclass(frozen=True)
class Plane:
    """The plane of the floor, n·x = d, with two directions along its tiles."""

    normal: Float[np.ndarray, "3"]
    offset: float
    tiles: Float[np.ndarray, "3 2"]

    @classmethod
    def of(cls, ground: Ground | None) -> "Plane":
        """Make the floor's plane from a ground; None is z = 0."""
        if ground is None:
            ground = Ground(torch.tensor([0.0, 0.0, 1.0]), torch.tensor(0.0))
        ground = ground.detach().to(device="cpu", dtype=torch.float64)
        basis = tangent_basis(ground.normal)
        return cls(ground.normal.numpy(), float(ground.offset), basis.numpy())

    def depth(self, view: Viewpoint, sunk: float = 0.0) -> Float[np.ndarray, "height width"]:
        """Return the floor's depth at every pixel, metres, if it is lowered by `sunk` metres."""
        above = float(view.position @ self.normal - self.offset) + sunk
        width, height = view.size
        unit = np.ones((height, width), np.float32)
        fall = (
            above
            - view.coordinates_along(self.normal[None], unit)[0]
            + np.float32(self.offset - sunk)
        )
        if above <= 0:
            return np.full_like(fall, FARTHEST_M)
        return above / np.maximum(fall, above / FARTHEST_M)


def direction_to_lamp(view: Viewpoint) -> Float[np.ndarray, "3"]:
    """Return the unit vector towards a lamp far above the viewer's left shoulder."""
    right, _, forward = view.R_camera_world
    level = np.array([-forward[0], -forward[1], 0.0])
    toward = 0.75 * level / np.linalg.norm(level) - 0.65 * right + np.array([0, 0, 1.1])
    return toward / np.linalg.norm(toward)


def shadow_on_floor(
    bodies: list[Mesh], plane: Plane, view: Viewpoint
) -> Float[np.ndarray, "height width"]:
    """Return the share of the lamp's light that bodies block at every pixel of the floor."""
    toward = direction_to_lamp(view)
    dark = np.zeros(view.size[::-1], np.float32)
    for vertices, faces in bodies:
        along = (vertices @ plane.normal - plane.offset) / (toward @ plane.normal)
        pixels, depth = view.project(vertices - along[:, None] * toward)
        seen = faces[(depth > NEAREST_M)[faces].all(1)]
        dark = np.maximum(dark, rasterise(pixels, depth, seen, view.size).covered)
    away = float(np.linalg.norm(view.target - view.position))
    return cv2.GaussianBlur(dark, (0, 0), PENUMBRA_M * view.focal / away)


def floor_picture(
    plane: Plane, view: Viewpoint, shadow: Float[np.ndarray, "height width"]
) -> Float[np.ndarray, "height width 3"]:
    """Paint the floor alone: tiles that fade into the sky, darkened by a shadow."""
    fine = view.scaled(SUPERSAMPLING)
    number = np.floor(fine.coordinates_along(plane.tiles.T / TILE_M, plane.depth(fine))).astype(
        np.int32
    )
    odd = (number.sum(0) & 1).astype(np.float32)
    odd = cv2.resize(odd, view.size, interpolation=cv2.INTER_AREA)[..., None]
    places = view.coordinates_along(plane.tiles.T, plane.depth(view))
    places -= (view.target @ plane.tiles)[:, None, None]
    reach = max(FADE_M, FADE_SHARE * float(np.linalg.norm(view.target - view.position)))
    fade = np.exp(-np.square(places / reach).sum(0))[..., None]
    tiles = TILES[0] + odd * (TILES[1] - TILES[0])
    return SKY + fade * (tiles * (1 - SHADE * shadow[..., None]) - SKY)


DIRECT = 0.95
"""Light of the lamp on a surface that faces it; 1 shows a colour as it is."""
DARKEST = 1e-6
"""Least light, which shows as black; OpenCV takes ten times as long for powers of zero."""
FLOOR_SLACK_M = 0.004
"""Depth, metres, up to which a sole may sink before the floor hides it."""
CLOUD_LIMIT = 3000
"""Most points of a scan that are drawn per frame."""
GRAIN_M = 0.006
"""Radius of a scan's points, metres."""
SMALLEST_PX = 1.5
"""Least radius of a sphere, in supersampled pixels."""
HALO = 0.4
"""Opacity of the spheres that show standard deviations: the body is seen through them."""
PYRAMID_M = 0.4
"""Length of a camera's pyramid along the viewing axis, metres."""
EDGE_PX = 1.8
"""Radius of the edges of a camera's pyramid, in supersampled pixels."""


@dataclass(frozen=True)
class LitSurface:
    """A surface in the world, with the light that each vertex emits towards the viewer."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    light: Float[np.ndarray, "vertices 3"]
    """Amounts of red, green and blue light, 0 to 1."""
    front: float = 1.0
    """Opacity where nothing lies before it."""
    through: float = 0.0
    """Opacity where another surface lies before it."""


def paint(show: Show, frame: int, view: Viewpoint) -> UInt8[np.ndarray, "height width 3"]:
    """Paint one frame of a scene as an RGB picture."""
    plane = Plane.of(show.ground)
    bodies: list[Mesh] = [
        (figure.posed.vertices[frame].double().numpy(), figure.body.faces.cpu().numpy())
        for figure in show.figures
    ]
    picture = floor_picture(plane, view, shadow_on_floor(bodies, plane, view))
    surfaces = [
        _lit_body(figure, mesh, frame, view)
        for figure, mesh in zip(show.figures, bodies, strict=True)
    ]
    surfaces.sort(key=lambda surface: -surface.front)
    surfaces += [*_lit_points(show, frame, view), *_camera_pyramids(show, frame, view)]
    left, top, right, bottom = _bounding_box(np.concatenate([s.vertices for s in surfaces]), view)
    if right > left and bottom > top:
        # supersample only the rectangle that bodies cover
        fine = view.part(left, top, right, bottom).scaled(SUPERSAMPLING)
        beneath = picture[top:bottom, left:right]
        image = cv2.resize(beneath, fine.size, interpolation=cv2.INTER_NEAREST)
        depth = plane.depth(fine, FLOOR_SLACK_M)
        for surface in surfaces:
            _paint_surface(surface, image, depth, fine)
        size = (right - left, bottom - top)
        picture[top:bottom, left:right] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return cv2.convertScaleAbs(picture)


def linear_light(colour: Colour) -> Float[np.ndarray, "3"]:
    """Convert a colour to linear amounts of light, 0 to 1."""
    return (np.array(colour) / 255) ** 2.2


def blend(
    image: Float[np.ndarray, "height width 3"],
    light: Float[np.ndarray, "height width 3"],
    opacity: Float[np.ndarray, "height width"],
) -> None:
    """Blend linear light, converted to colours (0 to 255), into a picture."""
    painted = 255 * cv2.pow(np.clip(light, DARKEST, 1), 1 / 2.2)
    image += opacity[..., None] * (painted - image)


def base_light(figure: Figure, frame: int) -> Float[np.ndarray, "vertices 3"]:
    """Return the linear colour of every vertex: the figure's, or that of a mark near its joint.

    Marks are on limbs that are unsure or were inferred, and on joints that touch the ground.
    """
    light = np.broadcast_to(linear_light(figure.colour), (len(figure.body.weights), 3))
    for marked, colour in (
        (figure.unsure_limbs, CERTAINTY),
        (figure.inferred_limbs, MISSING),
        (figure.touching, CONTACT),
    ):
        if bool(marked[frame].any()):
            share = figure.body.weights @ marked[frame].to(figure.body.weights)
            share = share.double().numpy()[:, None]
            light = light * (1 - share) + linear_light(colour) * share
    return light


def frustum(camera: Camera) -> Float[np.ndarray, "8 2 3"]:
    """Return the edges of a camera's pyramid: from centre to image corners, and between these.

    World, metres. Distortion is ignored: its inverse need not exist at the corners.
    """
    width, height = camera.image_size
    outline = [[0, 0], [width, 0], [width, height], [0, height]]
    pixels = torch.tensor(outline, dtype=torch.float64)
    straight = camera.detach().to(device="cpu", dtype=torch.float64).replace(distortion=None)
    depth = torch.full((4,), PYRAMID_M, dtype=torch.float64)
    corners = straight.unproject(pixels, depth).numpy()
    centre = np.broadcast_to(straight.T_world_camera[:3, 3].numpy(), (4, 3))
    rays, rim = np.stack([centre, corners], 1), np.stack([corners, np.roll(corners, -1, 0)], 1)
    return np.concatenate([rays, rim])


def _lit_body(figure: Figure, mesh: Mesh, frame: int, view: Viewpoint) -> LitSurface:
    """Make the surface of a body, lit by sky, floor and lamp, with a little gloss."""
    vertices, faces = mesh
    normals = vertex_normals(vertices, faces)
    eye = view.position - vertices
    eye /= np.linalg.norm(eye, axis=1, keepdims=True)
    toward = direction_to_lamp(view)
    halfway = eye + toward
    halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
    rim = 0.10 * (1 - np.clip((normals * eye).sum(1), 0, 1)) ** 3
    ambient = 0.37 + 0.15 * normals[:, 2] + rim
    facing = np.clip(normals @ toward, 0, 1)
    gloss = 0.10 * np.clip((normals * halfway).sum(1), 0, 1) ** 28
    amount = ambient + DIRECT * facing
    light = base_light(figure, frame) * amount[:, None] + gloss[:, None]
    return LitSurface(vertices, faces, light, front=figure.opacity)


def _lit_points(show: Show, frame: int, view: Viewpoint) -> list[LitSurface]:
    """Make surfaces of standard deviations, scan and points, which shine through the body."""
    found: list[LitSurface] = []
    if show.certainty:
        for figure in show.figures:
            if figure.joint_std is not None:
                joints, radii = figure.posed.joints[frame], figure.joint_std[frame].cpu().numpy()
                found.append(_lit_spheres(joints, radii, CERTAINTY, view, HALO, HALO))
    if show.cloud is not None:
        cloud = at_most_points(show.cloud[frame], CLOUD_LIMIT)
        found.append(_lit_spheres(cloud, GRAIN_M, CLOUD, view, 1.0, 0.12))
    if (points := show.points) is not None:
        seen = points.visible[frame]
        found.append(_lit_spheres(points.positions[frame][seen], points.radius, VISIBLE, view))
        if points.estimated is not None:
            found.append(
                _lit_spheres(points.estimated[frame][~seen], points.radius, MISSING, view)
            )
    return found


def _lit_spheres(
    centres: Float[Tensor, "balls 3"],
    radii: float | Float[np.ndarray, " balls"],
    colour: Colour,
    view: Viewpoint,
    opacity_in_front: float = 1.0,
    opacity_behind: float = 0.62,
) -> LitSurface:
    """Make spheres that are lit from the viewer's upper left and at least a pixel large."""
    places = centres.detach().cpu().double().numpy()
    ball = trimesh.creation.icosphere(subdivisions=1 if len(places) > 200 else 2)
    across, down, away = view.R_camera_world @ ball.vertices.T
    facing = np.clip(-0.35 * across - 0.45 * down - 0.75 * away, 0, 1)
    depth = np.abs((places - view.position) @ view.R_camera_world[2])
    radii = np.maximum(radii, SMALLEST_PX * depth / (SUPERSAMPLING * view.focal))
    vertices = places[:, None] + radii[:, None, None] * ball.vertices
    light = linear_light(colour) * (0.45 + 0.7 * facing)[:, None]
    return _copies_of_mesh(vertices, ball.faces, light[None], opacity_in_front, opacity_behind)


def _camera_pyramids(show: Show, frame: int, view: Viewpoint) -> list[LitSurface]:
    """Make the cameras' pyramids of thin rods, faint where a surface hides them."""
    found: list[LitSurface] = []
    for camera in show.cameras:
        lines = frustum(camera.at(frame))
        depth = abs(float((lines.mean((0, 1)) - view.position) @ view.R_camera_world[2]))
        radius = EDGE_PX * depth / (SUPERSAMPLING * view.focal)
        rods = [trimesh.creation.cylinder(radius, sections=6, segment=line) for line in lines]
        vertices = np.stack([rod.vertices for rod in rods])
        light = np.broadcast_to(linear_light(CAMERA), vertices.shape)
        found.append(_copies_of_mesh(vertices, rods[0].faces, light, opacity_behind=0.2))
    return found


def _copies_of_mesh(
    vertices: Float[np.ndarray, "copies vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    light: Float[np.ndarray, "#copies vertices 3"],
    opacity_in_front: float = 1.0,
    opacity_behind: float = 0.0,
) -> LitSurface:
    """Join many copies of one mesh to a single surface."""
    copies, count = vertices.shape[:2]
    every = np.arange(copies)[:, None, None] * count + faces
    light = np.broadcast_to(light, vertices.shape).reshape(-1, 3)
    return LitSurface(
        vertices.reshape(-1, 3), every.reshape(-1, 3), light, opacity_in_front, opacity_behind
    )


def _bounding_box(
    points: Float[np.ndarray, "points 3"], view: Viewpoint
) -> tuple[int, int, int, int]:
    """Return the bounding box of points in a picture, pixels: left, top, right, bottom.

    It is the whole picture if any point is behind the viewer or very near.
    """
    pixels, depth = view.project(points)
    if depth.min() <= NEAREST_M:
        return 0, 0, *view.size
    left, top = np.clip(np.floor(pixels.min(0)) - 2, 0, view.size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(pixels.max(0)) + 2, 0, view.size).astype(int).tolist()
    return left, top, right, bottom


def _paint_surface(
    surface: LitSurface,
    image: Float[np.ndarray, "height width 3"],
    depth: Float[np.ndarray, "height width"],
    view: Viewpoint,
) -> None:
    """Paint a surface into a picture and, if it is opaque, into its depth buffer."""
    pixels, away = view.project(surface.vertices)
    faces = surface.faces[(away > NEAREST_M)[surface.faces].all(1)]
    raster = rasterise(pixels, away, faces, view.size, surface.light)
    front = raster.depth < depth
    opacity = np.where(front, surface.front, surface.through) * raster.covered
    blend(image, raster.values, opacity.astype(np.float32))
    if surface.front == 1 and surface.through == 0:
        np.copyto(depth, raster.depth, where=front)
