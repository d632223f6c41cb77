"""What a camera of the scene sees: the body in its image, and its points against the detected."""

import cv2
import numpy as np

from recon.core.camera import Camera
from recon.core.geometry.normals import vertex_normals
from recon.core.geometry.raster import rasterise
from recon.view.drawing.lettering import Picture
from recon.view.drawing.marks import draw_discs, draw_rings, draw_segments
from recon.view.drawing.painter import CLOUD_LIMIT
from recon.view.drawing.shading import contact_shares, display, linear
from recon.view.drawing.stage import SUPERSAMPLING
from recon.view.show.colours import CLOUD, CONTACT, MISSING, REPROJECTED, VISIBLE, WHITE, Colour
from recon.view.show.regions import Region, drawable
from recon.view.show.scene import Figure, Show
from recon.view.show.views import UNSURE, View

BACKGROUND = (245.0, 246.0, 248.0)
FRAME: Colour = (206, 211, 219)
BODY_OPACITY = 0.85
"""Opacity of solid bodies, so that the image's frame and other bodies stay seen."""
DOT, RING, SPECK, GRAIN = 7.0, 8.5, 3.5, 2.0
"""Radii of detected, unsure and reprojected points and of a scan's; pixels before
they are halved."""


def paint_view(show: Show, view: View, frame: int, part: Region, across: int) -> Picture:
    """A part of a camera's image at one frame, without the photograph, `across` pixels wide.

    Paper lies around the image; what is drawn on it the camera could not see.
    """
    fine = SUPERSAMPLING * across
    width, height = part.size(fine)
    image = np.full((height, width, 3), 255, np.float32)
    edges = np.array([(0, 0), view.camera.image_size], float)
    corner, opposite = (
        tuple(np.round(end).astype(int).tolist()) for end in part.place(edges, fine)
    )
    cv2.rectangle(image, corner, opposite, BACKGROUND, -1)
    cv2.rectangle(image, corner, opposite, FRAME, SUPERSAMPLING)
    camera = view.at(frame)
    for figure in sorted(show.figures, key=lambda figure: -figure.opacity):
        _paint_body(figure, camera, frame, part, image)
    if show.cloud is not None:
        cloud = show.cloud[frame].detach().cpu().double()
        cloud = cloud[:: max(1, -(-len(cloud) // CLOUD_LIMIT))]
        pixels = camera.project(cloud).pixels[drawable(camera, cloud)].numpy()
        draw_discs(image, part.place(pixels, fine), GRAIN, CLOUD)
    if view.pixels is not None:
        _paint_points(view, frame, part, image)
    small = cv2.resize(image, part.size(across), interpolation=cv2.INTER_AREA)
    return np.clip(small + 0.5, 0, 255).astype(np.uint8)


def _paint_body(
    figure: Figure, camera: Camera, frame: int, part: Region, image: np.ndarray
) -> None:
    """The surface as the camera sees it, lit from the camera."""
    points = figure.posed.vertices[frame].double()
    faces = figure.body.faces.cpu().numpy()
    kept = drawable(camera, points).numpy()
    faces = faces[kept[faces].all(1)]
    if len(faces) == 0:
        return
    seen = camera.project(points)
    local = camera.to_camera(points).numpy()
    toward = -local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-12)
    facing = (vertex_normals(local, faces) * toward).sum(1)
    share = contact_shares(figure, frame)[:, None]
    colour = linear(figure.colour) * (1 - share) + linear(CONTACT) * share
    light = colour * (0.30 + 0.70 * np.clip(facing, 0, 1))[:, None]
    height, width = image.shape[:2]
    pixels = part.place(seen.pixels.numpy(), width)
    raster = rasterise(pixels, seen.depth.numpy(), faces, (width, height), light)
    opacity = BODY_OPACITY * figure.opacity
    painted = cv2.addWeighted(display(raster.values), opacity, image, 1 - opacity, 0)
    cv2.copyTo(painted, raster.covered.view(np.uint8), image)


def _paint_points(view: View, frame: int, part: Region, image: np.ndarray) -> None:
    """Detected points, those of the body, and a line between the two of each."""
    assert view.pixels is not None
    width = image.shape[1]
    found = part.place(view.pixels[frame].detach().cpu().double().numpy(), width)
    certainty = view.certainty[frame].double().numpy()
    sure, unsure = certainty >= UNSURE, (certainty > 0) & (certainty < UNSURE)
    own, drawn = found, np.zeros(len(found), bool)
    if view.reprojected is not None:
        pixels = view.reprojected.pixels[frame].detach().cpu().double().numpy()
        own, drawn = part.place(pixels, width), view.reprojected.in_front[frame].cpu().numpy()
    joined = drawn & (sure | unsure)
    draw_segments(image, found[joined], own[joined], REPROJECTED)
    draw_discs(image, found[sure], DOT + 2.0, WHITE)
    draw_discs(image, found[sure], DOT, VISIBLE, 0.35 + 0.65 * certainty[sure])
    draw_rings(image, found[unsure], RING, VISIBLE)
    draw_discs(image, own[joined], SPECK, REPROJECTED)
    draw_rings(image, own[drawn & (certainty == 0)], RING, MISSING)
