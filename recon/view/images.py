"""Draws what a camera's image shows: the body, detected points and their errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.camera import Camera
from recon.core.raster import rasterise, vertex_normals
from recon.view.lettering import FARTHEST_PX, FRACTION_BITS, PAPER, Picture, draw_dots, fixed_point
from recon.view.painter import CLOUD_LIMIT, SUPERSAMPLING, base_light, blend
from recon.view.scene import (
    CLOUD,
    MISSING,
    REPROJECTED,
    UNSURE,
    VISIBLE,
    WHITE,
    Colour,
    Figure,
    Show,
    View,
    at_most_points,
)

BEYOND = 0.5
"""Margin around the image, as a share of its size, in which surfaces are still drawn: far outside,
the equations of a lens fold points back into the image."""
MARGIN = 0.14
"""Empty space around the people on each side, as a share of their extent."""
SMALLEST = 0.1
"""Least width of a shown region, as a share of the image's width."""
BACKGROUND = (245.0, 246.0, 248.0)
FRAME: Colour = (206, 211, 219)
FILM_SMALLEST = 0.5
"""Least share of a film's width that is shown: enough to see a person beside a wrong body."""
BODY_OPACITY = 0.85
"""Opacity of solid bodies, so that the image's frame and other bodies stay visible."""
FILM_OPACITY = 0.6
"""Opacity of solid bodies over a film, so that the person below stays visible."""
DOT_PX, RING_PX, SPECK_PX, GRAIN_PX = 7.0, 8.5, 3.5, 2.0
"""Radii of detected, unsure, reprojected and scanned points, in supersampled pixels."""
LINE_PX = 2
"""Thickness of lines and rings, in supersampled pixels."""


@dataclass(frozen=True)
class ImageRegion:
    """A rectangle in the plane of an image, pixels; it may reach beyond the image."""

    left: float
    top: float
    width: float
    """Width in pixels of the image, which are the unit of all four fields."""
    height: float

    def place(
        self, pixels: Float[np.ndarray, "points 2"], across: int
    ) -> Float[np.ndarray, "points 2"]:
        """Map pixels of the image to those of a picture of the region, `across` pixels wide."""
        return (pixels - (self.left, self.top)) * (across / self.width)

    def size(self, across: int) -> tuple[int, int]:
        """Return width and height of a picture of the region that is `across` pixels wide."""
        return across, max(1, round(across * self.height / self.width))


def whole_image(view: View) -> ImageRegion:
    """Return the region of a camera's whole image."""
    width, height = view.camera.image_size
    return ImageRegion(0.0, 0.0, float(width), float(height))


def clip_region(show: Show, view: View) -> ImageRegion:
    """Return the part of a camera's image that people enter in the clip; same aspect ratio."""
    low, high, seen = _bounds_over_time(show, view)
    if not seen.any():
        return whole_image(view)
    size = np.array(view.camera.image_size, float)
    first, last = low[seen].min(0), high[seen].max(0)
    smallest = SMALLEST if view.film is None else FILM_SMALLEST
    share = np.clip(((last - first) * (1 + 2 * MARGIN) / size).max(), smallest, 1.0)
    left, top = np.clip((first + last - share * size) / 2, 0, (1 - share) * size)
    return ImageRegion(float(left), float(top), *(share * size).tolist())


def close_up_regions(show: Show, view: View, frames: Sequence[int]) -> list[ImageRegion]:
    """Return a square around the people in each of some frames, all of one size."""
    low, high, seen = (values[list(frames)] for values in _bounds_over_time(show, view))
    size = np.array(view.camera.image_size, float)
    side = (high - low)[seen].max() * (1 + 2 * MARGIN) if seen.any() else size.max()
    side = float(np.clip(side, SMALLEST * size[0], size.max()))
    middles = np.where(seen[:, None], (low + high) / 2, size / 2)
    return [ImageRegion(x - side / 2, y - side / 2, side, side) for x, y in middles.tolist()]


def drawable(
    camera: Camera, points: Float[Tensor, "*time points 3"]
) -> Bool[Tensor, "*time points"]:
    """Return a mask of points in front of the camera and not far outside its image."""
    straight = camera.replace(distortion=None).project(points)
    size = straight.pixels.new_tensor(camera.image_size)
    near = (straight.pixels > -BEYOND * size) & (straight.pixels < (1 + BEYOND) * size)
    return straight.in_front & near.all(-1)


def _bounds_over_time(
    show: Show, view: View
) -> tuple[Float[np.ndarray, "time 2"], Float[np.ndarray, "time 2"], Bool[np.ndarray, " time"]]:
    """Return the bounding box of people and confident points per frame, and whether it exists."""
    camera = view.camera.detach().to(device="cpu", dtype=torch.float64)
    pixels: list[Tensor] = []
    counted: list[Tensor] = []
    for figure in show.figures:
        some = torch.arange(0, len(figure.body.template), 40)
        surface = figure.posed.points(some).double()
        pixels.append(camera.project(surface).pixels)
        counted.append(drawable(camera, surface))
    if view.pixels is not None:
        pixels.append(view.pixels.detach().cpu().double())
        counted.append(view.certainty >= UNSURE)
    points = torch.cat(pixels, 1)
    inside = torch.cat(counted, 1) & camera.in_image(points)
    low = torch.where(inside[..., None], points, torch.inf).amin(1)
    high = torch.where(inside[..., None], points, -torch.inf).amax(1)
    seen = inside.any(1)
    low, high = (torch.where(seen[:, None], end, 0.0) for end in (low, high))
    return low.numpy(), high.numpy(), seen.numpy()


def paint_view(
    show: Show,
    view: View,
    frame: int,
    part: ImageRegion,
    across: int,
    photograph: Picture | None = None,
) -> Picture:
    """Draw a region of a camera's image in one frame, `across` pixels wide.

    White paper surrounds the image; anything drawn on it is outside the camera's view. Bodies are
    drawn over a photograph of any resolution, or over an empty image.
    """
    picture = _background(view, part, across, photograph)
    camera = view.at(frame)
    bodies = [
        _LitBody.of(figure, camera, frame)
        for figure in sorted(show.figures, key=lambda figure: -figure.opacity)
    ]
    places = [body.pixels[body.faces].reshape(-1, 2) for body in bodies]
    if show.cloud is not None:
        cloud = at_most_points(show.cloud[frame].detach().cpu().double(), CLOUD_LIMIT)
        places.append(camera.project(cloud).pixels[drawable(camera, cloud)].numpy())
    if view.pixels is not None:
        places.append(view.pixels[frame].detach().cpu().double().numpy())
        if (own := view.reprojected) is not None:
            places.append(own.pixels[frame][own.in_front[frame]].detach().cpu().double().numpy())
    # supersample only the rectangle with bodies and points
    drawn = part.place(np.concatenate(places), across)
    if len(drawn) == 0:
        return picture
    ends = np.stack([drawn.min(0) - DOT_PX, drawn.max(0) + DOT_PX + 1])
    (left, top), (right, bottom) = np.clip(ends, 0, part.size(across)).astype(int).tolist()
    if left == right or top == bottom:
        return picture
    size, beneath = np.array([right - left, bottom - top]), picture[top:bottom, left:right]
    per_pixel = part.width / across
    corner = np.array([part.left, part.top]) + per_pixel * np.array([left, top])
    inner = ImageRegion(*corner.tolist(), *(per_pixel * size).tolist())
    size = (SUPERSAMPLING * size).tolist()
    fine = cv2.resize(beneath, size, interpolation=cv2.INTER_NEAREST).astype(np.float32)
    for body in bodies:
        body.paint(inner, fine, BODY_OPACITY if photograph is None else FILM_OPACITY)
    fine = cv2.convertScaleAbs(fine)
    if show.cloud is not None:
        draw_dots(fine, inner.place(places[len(bodies)], size[0]), GRAIN_PX, CLOUD)
    if view.pixels is not None:
        _paint_points(view, view.pixels[frame], frame, inner, fine)
    beneath[:] = cv2.resize(fine, beneath.shape[1::-1], interpolation=cv2.INTER_AREA)
    return picture


def _background(view: View, part: ImageRegion, across: int, photograph: Picture | None) -> Picture:
    """Draw a region of an empty image, or of a photograph, with paper around it."""
    width, height = part.size(across)
    edges = part.place(np.array([(0, 0), view.camera.image_size], float), across)
    corner, opposite = np.round(edges).astype(int).tolist()
    if photograph is None:
        picture = np.full((height, width, 3), PAPER, np.uint8)
        cv2.rectangle(picture, corner, opposite, BACKGROUND, -1)
    else:
        rows, columns = photograph.shape[:2]
        scale = (edges[1] - edges[0]) / (columns, rows)
        if (coarser := int(1 / scale.min())) > 1:  # shrink first, since warping does not average
            smaller = (columns // coarser, rows // coarser)
            photograph = cv2.resize(photograph, smaller, interpolation=cv2.INTER_AREA)
            scale = (edges[1] - edges[0]) / smaller
        shift = edges[0] + 0.5 * scale - 0.5  # OpenCV's first pixel has its centre at 0
        turn = np.array([[scale[0], 0, shift[0]], [0, scale[1], shift[1]]])
        paper = (PAPER,) * 3
        picture = cv2.warpAffine(photograph, turn, (width, height), borderValue=paper)
        picture = picture.astype(np.uint8, copy=False)
    cv2.rectangle(picture, corner, opposite, FRAME, 1)
    return picture


@dataclass(frozen=True)
class _LitBody:
    """A body's surface as a camera sees it, lit from the camera."""

    pixels: Float[np.ndarray, "vertices 2"]
    depth: Float[np.ndarray, " vertices"]
    faces: Int[np.ndarray, "faces 3"]
    """Faces whose vertices are all `drawable`."""
    light: Float[np.ndarray, "vertices 3"]
    opacity: float

    @classmethod
    def of(cls, figure: Figure, camera: Camera, frame: int) -> "_LitBody":
        """Project and light the surface of a figure in a frame."""
        points = figure.posed.vertices[frame].double()
        faces = figure.body.faces.cpu().numpy()
        faces = faces[drawable(camera, points).numpy()[faces].all(1)]
        seen = camera.project(points)
        local = camera.to_camera(points).numpy()
        toward = -local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-12)
        facing = (vertex_normals(local, faces) * toward).sum(1)
        light = base_light(figure, frame) * (0.30 + 0.70 * np.clip(facing, 0, 1))[:, None]
        return cls(seen.pixels.numpy(), seen.depth.numpy(), faces, light, figure.opacity)

    def paint(
        self, part: ImageRegion, image: Float[np.ndarray, "height width 3"], opacity: float
    ) -> None:
        """Paint the surface into a picture of a region of the camera's image."""
        height, width = image.shape[:2]
        pixels = part.place(self.pixels, width)
        raster = rasterise(pixels, self.depth, self.faces, (width, height), self.light)
        blend(image, raster.values, np.float32(opacity * self.opacity) * raster.covered)


def _paint_points(
    view: View, pixels: Float[Tensor, "points 2"], frame: int, part: ImageRegion, picture: Picture
) -> None:
    """Paint detected points, the body's points, and lines between them."""
    width = picture.shape[1]
    found = part.place(pixels.detach().cpu().double().numpy(), width)
    certainty = view.certainty[frame].double().numpy()
    sure, unsure = certainty >= UNSURE, (certainty > 0) & (certainty < UNSURE)
    own, drawn = found, np.zeros(len(found), bool)
    if view.reprojected is not None:
        on_body = view.reprojected.pixels[frame].detach().cpu().double().numpy()
        own, drawn = part.place(on_body, width), view.reprojected.in_front[frame].cpu().numpy()
    joined = drawn & (sure | unsure)
    lines = np.stack([found, own], 1)[joined]
    lines = fixed_point(lines[np.abs(lines).max((1, 2)) < FARTHEST_PX])
    cv2.polylines(picture, list(lines), False, REPROJECTED, LINE_PX, cv2.LINE_AA, FRACTION_BITS)
    draw_dots(picture, found[sure], DOT_PX + 2.0, WHITE)
    for place, share in zip(found[sure], 0.65 * (1 - certainty[sure]), strict=True):
        pale = tuple(round(part + share * (255 - part)) for part in VISIBLE)
        draw_dots(picture, place[None], DOT_PX, pale)
    draw_dots(picture, found[unsure], RING_PX, VISIBLE, LINE_PX)
    draw_dots(picture, own[joined], SPECK_PX, REPROJECTED)
    draw_dots(picture, own[drawn & (certainty == 0)], RING_PX, MISSING, LINE_PX)
