"""Light on bodies: sky and floor, the lamp with its shadows, a gloss."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.core.geometry.normals import vertex_normals
from recon.core.geometry.raster import Raster, rasterise
from recon.view.drawing.stage import SHADOW_MAP, Light, strips
from recon.view.show.colours import CONTACT, Colour
from recon.view.show.scene import Figure
from recon.view.show.viewpoint import Viewpoint

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
