"""Images and films of a show, drawn on the processor: no GPU, no display, no browser."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from recon.formats.opening import replacing
from recon.view.lettering import (
    Picture,
    head,
    join,
    label,
    line_width,
    save_picture,
    text_size,
    with_legend,
    write_line,
)
from recon.view.painter import frustum, paint
from recon.view.scene import CAMERA, Colour, Show
from recon.view.viewpoint import Viewpoint, viewpoints


def write_film(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """Write pictures of one size as H.264 that every browser plays.

    Raises:
        ValueError: when there is no picture, or its width or height is odd (H.264 halves its
            colours).
        FileNotFoundError: when the folder of `path` does not exist.
    """
    import av

    with (
        replacing(path) as scratch,
        av.open(str(scratch), "w", format="mp4", options={"movflags": "+faststart"}) as film,
    ):
        stream = None
        for picture in pictures:
            if stream is None:
                height, width = picture.shape[:2]
                if width % 2 or height % 2:
                    raise ValueError(f"a film needs an even width and height, got {width, height}")
                stream = film.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
                stream.width, stream.height = width, height
                stream.pix_fmt = "yuv420p"
                # Beside "medium" at 19: half the time, and files of the same size, 0.5 dB worse.
                stream.options = {"crf": "18", "preset": "veryfast"}
            film.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is None:
            raise ValueError("a film needs at least one picture")
        film.mux(stream.encode(None))


def write_png(
    path: str | Path,
    shows: Sequence[Show],
    frames: Sequence[int] | None = None,
    size: tuple[int, int] = (360, 440),
) -> None:
    """A sheet of pictures: one row per show, one column per frame, one legend.

    All rows share one camera. `size` is the width and height of a single picture in pixels;
    without `frames` five are chosen evenly.

    Raises:
        ValueError: when shows differ in length or rate, or a frame does not exist.
        FileNotFoundError: when the folder of `path` does not exist.
    """
    if len(shows) == 0:
        raise ValueError("a sheet needs at least one show")
    lengths = {(show.frames, show.fps) for show in shows}
    if len(lengths) != 1:
        raise ValueError(f"rows of a sheet need one (frames, fps), got {sorted(lengths)}")
    chosen = evenly(shows[0].frames, 5) if frames is None else frames
    _check(size, chosen, shows[0].frames)
    views = viewpoints(shows, size)
    rows = [scene_row(show, chosen, views) for show in shows]
    entries = [entry for show in shows for entry in show.legend]
    save_sheet(Path(path), rows, entries, text_size(size))


def write_mp4(
    path: str | Path,
    show: Show,
    size: tuple[int, int] = (640, 720),
    frames: Sequence[int] | None = None,
) -> None:
    """A film in H.264 that every browser plays, one picture per frame at the show's rate.

    Raises:
        ValueError: when the size is odd (H.264 halves its colours) or leaves no room beside the
            legend, or a frame does not exist.
        FileNotFoundError: when the folder of `path` does not exist.
    """
    chosen = range(show.frames) if frames is None else frames
    _check(size, chosen, show.frames)
    if size[0] % 2 or size[1] % 2:
        raise ValueError(f"a film needs an even width and height, got {size}")
    text = text_size(size)
    legend = with_legend(np.empty((0, size[0], 3), np.uint8), show.legend, text)
    height = size[1] - len(legend)
    if 2 * height < size[1]:
        raise ValueError(f"a film of {size} has no room beside its legend; make it larger")
    views = viewpoints([show], (size[0], height))
    pictures = (scene_row(show, [frame], views)[0] for frame in chosen)
    write_film(Path(path), (np.concatenate([one, legend]) for one in pictures), show.fps)


def scene_row(show: Show, frames: Sequence[int], views: Sequence[Viewpoint]) -> list[Picture]:
    """Pictures of the scene with the names of its cameras and the time; the first has a title."""
    row: list[Picture] = []
    for frame in frames:
        view = views[frame]
        picture = paint(show, frame, view)
        _name_cameras(picture, show, frame, view)
        label(picture, f"{show.figures[0].motion.start_time + frame / show.fps:.2f} s")
        row.append(picture)
    head(row[0], show.title)
    return row


def _name_cameras(picture: Picture, show: Show, frame: int, view: Viewpoint) -> None:
    """Write the name of every camera above its pyramid."""
    text, (width, height) = text_size(view.size), view.size
    for camera in show.cameras:
        pixels, depth = view.project(frustum(camera.at(frame)).reshape(-1, 3))
        middle, top = pixels.mean(0), pixels.min(0)[1]
        if depth.min() > 0 and 0 <= middle[0] < width and text < top < height:
            half = line_width(camera.name, text) / 2
            x = np.clip(middle[0] - half, text / 2, max(width - 2 * half - text / 2, text / 2))
            place = (round(float(x)), round(float(top)) - text // 2)
            write_line(picture, camera.name, place, text, colour=CAMERA)


def save_sheet(
    path: Path, rows: list[list[Picture]], entries: Iterable[tuple[str, Colour]], text: int
) -> None:
    """Write rows of pictures and a legend below them as a PNG."""
    sheet = join([join(row, axis=1) for row in rows], axis=0)
    save_picture(path, with_legend(sheet, entries, text))


def evenly(count: int, wanted: int) -> list[int]:
    """Numbers of at most `wanted` of `count` frames, evenly spread from the first to the last."""
    return sorted({round(place) for place in np.linspace(0, count - 1, wanted)})


def _check(size: tuple[int, int], frames: Sequence[int], count: int) -> None:
    if min(size) < 64 or max(size) > 4096:
        raise ValueError(f"a picture is 64 to 4096 pixels wide and high, got {size}")
    if len(frames) == 0 or not all(0 <= frame < count for frame in frames):
        raise ValueError(f"frames must be among 0, ..., {count - 1}, got {list(frames)}")
