"""The region of a camera's image that is worth showing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.camera import Camera
from recon.view.scene import Show
from recon.view.views import UNSURE, View

BEYOND = 0.5
"""Share of the image's size around it within which surfaces are drawn: far outside, the equations
of a lens fold points back into the image."""
MARGIN = 0.14
"""Empty space around the people on each side, as a share of their extent."""
SMALLEST = 0.1
"""Share of the image's width that is shown at least."""


@dataclass(frozen=True)
class Region:
    """A rectangle in the plane of an image; it may reach beyond the image."""

    left: float
    top: float
    width: float
    """Pixels of the image."""
    height: float

    def place(
        self, pixels: Float[np.ndarray, "points 2"], across: int
    ) -> Float[np.ndarray, "points 2"]:
        """Pixels of the image in a picture of the region that is `across` pixels wide."""
        return (pixels - (self.left, self.top)) * (across / self.width)

    def size(self, across: int) -> tuple[int, int]:
        """Width and height of such a picture."""
        return across, max(1, round(across * self.height / self.width))


def whole(view: View) -> Region:
    """All of a camera's image."""
    width, height = view.camera.image_size
    return Region(0.0, 0.0, float(width), float(height))


def clip_region(show: Show, view: View) -> Region:
    """The part of a camera's image, of its aspect ratio, that people are in during the clip."""
    low, high, seen = _extents(show, view)
    if not seen.any():
        return whole(view)
    size = np.array(view.camera.image_size, float)
    first, last = low[seen].min(0), high[seen].max(0)
    share = np.clip(((last - first) * (1 + 2 * MARGIN) / size).max(), SMALLEST, 1.0)
    left, top = np.clip((first + last - share * size) / 2, 0, (1 - share) * size)
    return Region(float(left), float(top), *(share * size).tolist())


def close_ups(show: Show, view: View, frames: Sequence[int]) -> list[Region]:
    """A square around the people in each of some frames, all of one size."""
    low, high, seen = (values[list(frames)] for values in _extents(show, view))
    size = np.array(view.camera.image_size, float)
    side = (high - low)[seen].max() * (1 + 2 * MARGIN) if seen.any() else size.max()
    side = float(np.clip(side, SMALLEST * size[0], size.max()))
    middles = np.where(seen[:, None], (low + high) / 2, size / 2)
    return [Region(x - side / 2, y - side / 2, side, side) for x, y in middles.tolist()]


def drawable(
    camera: Camera, points: Float[Tensor, "*time points 3"]
) -> Bool[Tensor, "*time points"]:
    """Points before the camera and, were the lens perfect, not far outside its image."""
    straight = camera.replace(distortion=None).project(points)
    size = straight.pixels.new_tensor(camera.image_size)
    near = (straight.pixels > -BEYOND * size) & (straight.pixels < (1 + BEYOND) * size)
    return straight.in_front & near.all(-1)


def _extents(
    show: Show, view: View
) -> tuple[Float[np.ndarray, "time 2"], Float[np.ndarray, "time 2"], Bool[np.ndarray, " time"]]:
    """Least and greatest pixel of people and sure points in the image; frames that have any."""
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
