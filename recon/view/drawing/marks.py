"""Discs, rings and lines over a picture, smooth at their edges."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.core.camera import Camera
from recon.core.raster import rasterise, vertex_normals
from recon.formats.opening import replacing
from recon.view.drawing.painter import CLOUD_LIMIT, contact_shares, display, linear
from recon.view.drawing.stage import SUPERSAMPLING
from recon.view.regions import Region, drawable
from recon.view.scene import (
    CLOUD,
    CONTACT,
    FAINT,
    MISSING,
    REPROJECTED,
    VISIBLE,
    WHITE,
    Colour,
    Figure,
    Show,
)
from recon.view.views import UNSURE, View

BITS = 4
"""Bits of a pixel's fractions that OpenCV draws with."""
FAR = 1e5
"""Pixels beyond which no line is drawn: OpenCV counts in whole numbers."""
THICKNESS = 2
"""Thickness of lines and rings, pixels."""

Image = Float[np.ndarray, "height width 3"]
Places = Float[np.ndarray, "marks 2"]


def draw_discs(
    image: Image,
    places: Places,
    radius: float,
    colour: Colour,
    opacity: Float[np.ndarray, " marks"] | None = None,
) -> None:
    """Filled discs; `opacity` is 1 where it is not given."""
    cover = np.zeros(image.shape[:2], np.uint8)
    for k, place in enumerate(places):
        if abs(place).max() < FAR:
            level = 255 if opacity is None else round(255 * float(opacity[k]))
            cv2.circle(cover, _fixed(place), round(radius * 2**BITS), level, -1, cv2.LINE_AA, BITS)
    _blend(image, cover, colour)


def draw_rings(image: Image, places: Places, radius: float, colour: Colour) -> None:
    """Circles."""
    cover = np.zeros(image.shape[:2], np.uint8)
    for place in places:
        if abs(place).max() < FAR:
            size = round(radius * 2**BITS)
            cv2.circle(cover, _fixed(place), size, 255, THICKNESS, cv2.LINE_AA, BITS)
    _blend(image, cover, colour)


def draw_segments(image: Image, starts: Places, ends: Places, colour: Colour) -> None:
    """Straight lines."""
    cover = np.zeros(image.shape[:2], np.uint8)
    for start, end in zip(starts, ends, strict=True):
        if max(abs(start).max(), abs(end).max()) < FAR:
            cv2.line(cover, _fixed(start), _fixed(end), 255, THICKNESS, cv2.LINE_AA, BITS)
    _blend(image, cover, colour)


def _fixed(place: Float[np.ndarray, "2"]) -> tuple[int, int]:
    """OpenCV's fixed point; its first pixel has its centre at 0, ours at 0.5."""
    x, y = np.round((place - 0.5) * 2**BITS)
    return int(x), int(y)


def _blend(image: Image, cover: UInt8[np.ndarray, "height width"], colour: Colour) -> None:
    rows, columns = np.nonzero(cover)
    share = cover[rows, columns, None] / np.float32(255)
    image[rows, columns] += share * (np.array(colour, np.float32) - image[rows, columns])


Picture = UInt8[np.ndarray, "_ _ 3"]

PAPER = 255
REGULAR, BOLD = 400, 650
GAP = 4
"""Pixels between pictures."""


def save_picture(path: Path, picture: Picture) -> None:
    """Write a PNG.

    Raises:
        FileNotFoundError: when the folder of `path` does not exist.
    """
    with replacing(path) as scratch:
        written, data = cv2.imencode(".png", picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if not written:
            raise ValueError(f"could not encode a picture of shape {picture.shape} as PNG")
        scratch.write_bytes(data.tobytes())


def text_size(size: tuple[int, int]) -> int:
    """Height of the letters that suits a picture, pixels."""
    return min(max(10, min(size) // 26), 24)


def join(pictures: list[Picture], axis: int) -> Picture:
    """Side by side with a thin gap."""
    shape = list(pictures[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, PAPER, np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)][1:]
    return np.concatenate(parts, axis)


def legend_strip(entries: tuple[tuple[str, Colour], ...], width: int, text: int) -> Picture:
    """A white strip with as many lines as the entries need."""
    lines: list[list[tuple[str, Colour]]] = [[]]
    for entry in entries:
        if lines[-1] and _key_width((*lines[-1], entry), text) > width - text:
            lines.append([])
        lines[-1].append(entry)
    strip = np.full((text * (2 * len(lines) + 1), width, 3), PAPER, np.uint8)
    for k, line in enumerate(lines):
        _key(strip, tuple(line), text * (2 * k + 2) - text // 6, text)
    return strip


def _key(
    picture: Picture, entries: tuple[tuple[str, Colour], ...], baseline: int, text: int
) -> None:
    """Coloured discs with their words, along one line from the left."""
    x, radius = text, 0.42 * text
    for word, colour in entries:
        centre = (round((x + radius) * 16), round((baseline - 0.34 * text) * 16))
        cv2.circle(picture, centre, round(radius * 16), colour, -1, cv2.LINE_AA, shift=4)
        write_line(picture, word, (x + text * 4 // 3, baseline), text)
        x += _key_width(((word, colour),), text)


def _key_width(entries: tuple[tuple[str, Colour], ...], text: int) -> int:
    return sum(line_width(word, text) + text * 17 // 6 for word, _ in entries)


def write_line(
    picture: Picture,
    words: str,
    place: tuple[int, int],
    text: int,
    weight: int = REGULAR,
    colour: Colour = FAINT,
    right: bool = False,
) -> None:
    """Write one line whose baseline starts (or, with `right`, ends) at `place`."""
    start = (place[0] - line_width(words, text, weight) if right else place[0], place[1])
    cv2.putText(picture, words, start, colour, cv2.FontFace("sans"), text, weight)


def label(picture: Picture, words: str) -> None:
    """Write one line into the lower right corner."""
    height, width = picture.shape[:2]
    text = text_size((width, height))
    write_line(picture, words, (width - text // 2, height - text // 2), text, right=True)


def line_width(words: str, text: int, weight: int = REGULAR) -> int:
    """Width of a line in pixels, at `text` pixels high."""
    return cv2.getTextSize((0, 0), words, (0, 0), cv2.FontFace("sans"), text, weight)[2]


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
