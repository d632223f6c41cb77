"""Sheets and films of what every camera sees: the picture to judge a fit to images by."""

from pathlib import Path

import cv2
import numpy as np

from recon.view.frames import evenly, save_sheet, scene_row, write_film
from recon.view.images import FRAME, Region, clip_region, close_ups, paint_view
from recon.view.lettering import PAPER, Picture, head, join, label, text_size, with_legend
from recon.view.scene import FAINT, WHITE, Show, View
from recon.view.viewpoint import viewpoints

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
    chosen, size = evenly(show.frames, frames), (width, 3 * width // 4)
    rows = [scene_row(show, chosen, viewpoints([show], size))]
    for view in show.cameras:
        parts = close_ups(show, view, chosen)
        row = [
            paint_view(show, view, frame, part, width)
            for frame, part in zip(chosen, parts, strict=True)
        ]
        for picture, part in zip(row, parts, strict=True):
            _map(picture, view, part)
        _name(row[0], view)
        rows.append(row)
    save_sheet(Path(path), rows, (*show.legend, *show.image_legend), text_size(size))


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
        tiles = scene_row(show, [frame], stands)
        for view, part in zip(show.cameras, parts, strict=True):
            tiles.append(paint_view(show, view, frame, part, width))
            _name(tiles[-1], view)
        rows = [join(tiles[k : k + columns], axis=1) for k in range(0, len(tiles), columns)]
        entries = (*show.legend, *show.image_legend)
        whole = with_legend(join(rows, axis=0), entries, text_size((width, 3 * width // 4)))
        even = [(0, side % 2) for side in whole.shape[:2]]
        return np.pad(whole, (*even, (0, 0)), constant_values=PAPER)

    write_film(Path(path), map(picture, range(show.frames)), show.fps)


def _name(picture: Picture, view: View) -> None:
    """The camera's name, and how well its points are met."""
    head(picture, view.name)
    if (error := view.median_error) is not None:
        label(picture, f"median error {error:.1f} px")


def _map(picture: Picture, view: View, part: Region) -> None:
    """The image's outline in the lower left corner, with the part of it that is shown."""
    height, width = picture.shape[:2]
    size = np.array(view.camera.image_size, float)
    scale = MAP_SHARE * width / size.max()
    corner = np.array([width // 40, height - width // 40 - scale * size[1]])
    low = np.clip((part.left, part.top), 0, size)
    high = np.clip((part.left + part.width, part.top + part.height), 0, size)
    for first, last, colour, thickness in (
        (np.zeros(2), size, WHITE, -1),
        (low, high, FRAME, -1),
        (np.zeros(2), size, FAINT, 1),
    ):
        ends = np.stack([corner + scale * first, corner + scale * last])
        start, end = ends.round().astype(int).tolist()
        cv2.rectangle(picture, start, end, colour, thickness)


def _check(show: Show, width: int) -> None:
    if len(show.cameras) == 0:
        raise ValueError(
            "a picture of views needs a show with cameras; give 2D keypoints or a point cloud "
            "with its camera, or draw the scene alone with write_png or write_mp4"
        )
    if not 64 <= width <= 2048:
        raise ValueError(f"a picture is 64 to 2048 pixels wide, got {width}")
