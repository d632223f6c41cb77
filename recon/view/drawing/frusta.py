"""Cameras in the scene: the pyramids they look along, as lines."""

import cv2
import numpy as np
import torch
from jaxtyping import Float

from recon.core.camera import Camera
from recon.view.show.colours import Colour
from recon.view.show.viewpoint import Viewpoint

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
