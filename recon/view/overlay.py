"""Draws bodies over films: a film of the whole clip, or a sheet of some of its moments."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from recon.view.frames import evenly_spread, write_film
from recon.view.images import ImageRegion, clip_region, paint_view, whole_image
from recon.view.lettering import (
    Picture,
    join,
    lighten_corners,
    save_picture,
    with_legend,
    write_corner_label,
    write_title,
)
from recon.view.scene import Show, View

MOMENTS, COLUMNS = 8, 4
"""Number of pictures of each film in a sheet, and of pictures in a row."""
SHEET_SIDE, ONE_FILM_SIDE, FILM_SIDE = 400, 720, 480
"""Square roots of the areas of pictures, pixels: in a sheet, of one film, of several films."""
TEXT_PX = 14
"""Height of the letters of legends."""


def write_sheet(path: str | Path, show: Show) -> None:
    """Write eight moments of every film with the body over it, evenly spread, in two rows.

    Pictures show the part of the image in which people are.

    Args:
        path: file to write.
        show: a scene whose cameras have films.

    Raises:
        FileNotFoundError: when the folder of `path` does not exist.
    """
    frames, rows = evenly_spread(show.frames, MOMENTS), list[Picture]()
    for view in show.cameras:
        row = list(_film_pictures(show, view, frames, clip_region(show, view), SHEET_SIDE))
        rows += [join(row[k : k + COLUMNS], axis=1) for k in range(0, len(row), COLUMNS)]
    save_picture(Path(path), with_legend(join(rows, axis=0), _legend(show), TEXT_PX))


def write_overlay(path: str | Path, show: Show) -> None:
    """Write an H.264 film at the scene's frame rate: every camera's film with the body over it.

    Args:
        path: file to write.
        show: a scene whose cameras have films.

    Raises:
        FileNotFoundError: when the folder of `path` does not exist.
    """
    side = ONE_FILM_SIDE if len(show.cameras) == 1 else FILM_SIDE
    columns = int(np.ceil(np.sqrt(len(show.cameras))))
    every = [
        _film_pictures(show, view, range(show.frames), whole_image(view), side)
        for view in show.cameras
    ]

    def composed(tiles: Sequence[Picture]) -> Picture:
        rows = [join([*tiles[k : k + columns]], 1) for k in range(0, len(tiles), columns)]
        return with_legend(join(rows, axis=0), _legend(show), TEXT_PX)

    write_film(Path(path), map(composed, zip(*every, strict=True)), show.fps)


def _film_pictures(
    show: Show, view: View, frames: Sequence[int], part: ImageRegion, side: int
) -> Iterator[Picture]:
    """Draw a region of a camera's film with body, name and time, in each of some rising frames."""
    assert view.film is not None
    across = round(side * (part.width / part.height) ** 0.5)
    times = show.figures[0].motion.times[list(frames)].tolist()
    for frame, time, photograph in zip(frames, times, view.film.pictures(times), strict=True):
        picture = paint_view(show, view, frame, part, across, photograph)
        label = f"{time:.2f} s" if photograph is not None else f"no picture at {time:.2f} s"
        lighten_corners(picture, view.name, label)
        write_title(picture, view.name)
        write_corner_label(picture, label)
        yield picture


def _legend(show: Show) -> list[tuple[str, tuple[int, int, int]]]:
    """Return the legend of the scene without cameras, which are not drawn."""
    return [(word, colour) for word, colour in show.legend if word != "camera"]
