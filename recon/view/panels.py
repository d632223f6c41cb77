"""Sheets and films of what every camera sees: the picture to judge a fit to images by."""

from pathlib import Path

import cv2
import numpy as np

from recon.view.drawing.marks import (
    BOLD,
    FRAME,
    PAPER,
    Picture,
    join,
    label,
    legend_strip,
    paint_view,
    save_picture,
    text_size,
    write_line,
)
from recon.view.frames import evenly, paint_scene, seconds, write_film
from recon.view.regions import Region, clip_region, close_ups
from recon.view.scene import FAINT, INK, Show
from recon.view.viewpoint import viewpoints
from recon.view.views import View

MAP_SHARE = 0.13
"""Width of the little map as a share of the picture's."""


def write_views_png(path: str | Path, show: Show, frames: int = 6, width: int = 400) -> None:
    """A sheet: the scene in the first row, then a row per camera; a column per frame.

    The images are squares around the people; a little map shows where in the image they lie.
    `frames` are spread evenly over the clip, `width` is that of one picture in pixels.

    Raises:
        ValueError: when the show has no camera, or `frames` or `width` make no picture.
        FileNotFoundError: when the folder of `path` does not exist.
    """
    _check(show, width)
    if frames < 1:
        raise ValueError(f"a sheet needs at least one frame, got {frames}")
    chosen = evenly(show.frames, frames)
    stands = viewpoints([show], (width, 3 * width // 4))
    rows = [[paint_scene(show, frame, stands[frame]) for frame in chosen]]
    _head(rows[0][0], show.title)
    for picture, frame in zip(rows[0], chosen, strict=True):
        label(picture, seconds(show, frame))
    for view in show.cameras:
        row: list[Picture] = []
        for frame, part in zip(chosen, close_ups(show, view, chosen), strict=True):
            row.append(paint_view(show, view, frame, part, width))
            _map(row[-1], view, part)
        _head(row[0], view.name)
        label(row[0], _account(view))
        rows.append(row)
    sheet = join([join(row, axis=1) for row in rows], axis=0)
    save_picture(Path(path), np.concatenate([sheet, _legend(show, sheet.shape[1], _text(width))]))


def write_views_mp4(path: str | Path, show: Show, width: int = 480) -> None:
    """A film: the scene and what every camera sees, side by side in each picture.

    Raises:
        ValueError: when the show has no camera or `width` makes no picture.
        FileNotFoundError: when the folder of `path` does not exist.
    """
    _check(show, width)
    parts = [clip_region(show, view) for view in show.cameras]
    size = (width, max(min(parts[0].size(width)[1], width), width // 2))
    stands = viewpoints([show], size)
    columns = int(np.ceil(np.sqrt(len(parts) + 1)))

    def picture(frame: int) -> Picture:
        scene = paint_scene(show, frame, stands[frame])
        _head(scene, show.title)
        label(scene, seconds(show, frame))
        tiles = [scene, *_images(show, frame, parts, width)]
        rows = [_row(tiles[k : k + columns], columns) for k in range(0, len(tiles), columns)]
        sheet = join(rows, axis=0)
        strip = _legend(show, sheet.shape[1], _text(width))
        whole = np.concatenate([sheet, strip])
        even = [(0, side % 2) for side in whole.shape[:2]]
        return np.pad(whole, (*even, (0, 0)), constant_values=PAPER)

    write_film(Path(path), map(picture, range(show.frames)), show.fps)


def _images(show: Show, frame: int, parts: list[Region], width: int) -> list[Picture]:
    pictures: list[Picture] = []
    for view, part in zip(show.cameras, parts, strict=True):
        pictures.append(paint_view(show, view, frame, part, width))
        _head(pictures[-1], view.name)
        label(pictures[-1], _account(view))
    return pictures


def _row(tiles: list[Picture], columns: int) -> Picture:
    """Pictures of one width side by side, filled up with paper."""
    height = max(len(tile) for tile in tiles)
    empty = np.full((height, tiles[0].shape[1], 3), PAPER, np.uint8)
    filled = [
        np.pad(tile, ((0, height - len(tile)), (0, 0), (0, 0)), constant_values=PAPER)
        for tile in tiles
    ]
    return join([*filled, *[empty] * (columns - len(tiles))], axis=1)


def _head(picture: Picture, title: str) -> None:
    """A title in the upper left corner."""
    text = _text(picture.shape[1])
    write_line(picture, title, (text // 2, 3 * text // 2), text * 5 // 4, BOLD, INK)


def _text(width: int) -> int:
    """Height of the letters on pictures of this width, pixels."""
    return text_size((width, 3 * width // 4))


def _map(picture: Picture, view: View, part: Region) -> None:
    """The image's outline in the lower left corner, with the part of it that is shown."""
    height, width = picture.shape[:2]
    size = np.array(view.camera.image_size, float)
    scale = MAP_SHARE * width / size.max()
    corner = np.array([width // 40, height - width // 40 - scale * size[1]])
    low = np.clip((part.left, part.top), 0, size)
    high = np.clip((part.left + part.width, part.top + part.height), 0, size)
    for first, last, colour, thickness in (
        (np.zeros(2), size, (255, 255, 255), -1),
        (low, high, FRAME, -1),
        (np.zeros(2), size, FAINT, 1),
    ):
        start, end = (
            (corner + scale * place).round().astype(int).tolist() for place in (first, last)
        )
        cv2.rectangle(picture, start, end, colour, thickness)


def _account(view: View) -> str:
    """How well the points of a camera are met."""
    error = view.median_error
    return "" if error is None else f"median error {error:.1f} px"


def _legend(show: Show, width: int, text: int) -> Picture:
    entries = dict.fromkeys((*show.legend, *show.image_legend))
    return legend_strip(tuple(entries), width, text)


def _check(show: Show, width: int) -> None:
    if len(show.cameras) == 0:
        raise ValueError(
            "a picture of views needs a show with cameras; give 2D keypoints or a point cloud "
            "with its camera, or draw the scene alone with write_png or write_mp4"
        )
    if not 64 <= width <= 2048:
        raise ValueError(f"a picture is 64 to 2048 pixels wide, got {width}")
