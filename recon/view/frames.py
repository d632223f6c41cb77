"""Images and films of a show, drawn on the processor: no GPU, no display, no browser."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from recon.formats.opening import replacing
from recon.view.drawing.marks import (
    BOLD,
    Picture,
    join,
    label,
    legend_strip,
    line_width,
    save_picture,
    text_size,
    write_line,
)
from recon.view.drawing.painter import paint
from recon.view.drawing.stage import frustum
from recon.view.scene import CAMERA, INK, Show
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
    _check_size(size)
    count = shows[0].frames
    frames = evenly(count, 5) if frames is None else frames
    if len(frames) == 0 or not all(0 <= frame < count for frame in frames):
        raise ValueError(f"frames must be among 0, ..., {count - 1}, got {list(frames)}")

    views = viewpoints(shows, size)
    text = text_size(size)
    rows: list[Picture] = []
    for show in shows:
        pictures = [paint_scene(show, frame, views[frame]) for frame in frames]
        for frame, picture in zip(frames, pictures, strict=True):
            label(picture, seconds(show, frame))
        row = join(pictures, axis=1)
        write_line(row, show.title, (text // 2, 3 * text // 2), text * 5 // 4, BOLD, INK)
        rows.append(row)
    sheet = join(rows, axis=0)
    entries = dict.fromkeys(entry for show in shows for entry in show.legend)
    sheet = np.concatenate([sheet, legend_strip(tuple(entries), sheet.shape[1], text)])
    save_picture(Path(path), sheet)


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
    _check_size(size)
    if size[0] % 2 or size[1] % 2:
        raise ValueError(f"a film needs an even width and height, got {size}")
    frames = range(show.frames) if frames is None else frames
    if len(frames) == 0 or not all(0 <= frame < show.frames for frame in frames):
        raise ValueError(f"frames must be among 0, ..., {show.frames - 1}, got {list(frames)}")
    text = text_size(size)
    legend = legend_strip(show.legend, size[0], text)
    height = size[1] - len(legend)
    if 2 * height < size[1]:
        raise ValueError(f"a film of {size} has no room beside its legend; make it larger")
    views = viewpoints([show], (size[0], height))

    def picture(frame: int) -> Picture:
        picture = paint_scene(show, frame, views[frame])
        write_line(picture, show.title, (text, 2 * text), text * 5 // 4, BOLD, INK)
        write_line(picture, seconds(show, frame), (size[0] - text, 2 * text), text, right=True)
        return np.concatenate([picture, legend])

    write_film(Path(path), map(picture, frames), show.fps)


def paint_scene(show: Show, frame: int, view: Viewpoint) -> Picture:
    """The scene at one frame, with the names of its cameras."""
    picture = paint(show, frame, view)
    text = text_size(view.size)
    width, height = view.size
    for camera in show.cameras:
        corners = frustum(camera.at(frame)).reshape(-1, 3)
        pixels, depth = view.project(corners)
        middle, top = pixels.mean(0), pixels.min(0)[1]
        if depth.min() > 0 and 0 <= middle[0] < width and text < top < height:
            half = line_width(camera.name, text) / 2
            x = np.clip(middle[0] - half, text / 2, max(width - 2 * half - text / 2, text / 2))
            place = (round(float(x)), round(float(top)) - text // 2)
            write_line(picture, camera.name, place, text, colour=CAMERA)
    return picture


def evenly(count: int, wanted: int) -> list[int]:
    """Numbers of at most `wanted` of `count` frames, evenly spread from the first to the last."""
    return sorted({round(place) for place in np.linspace(0, count - 1, wanted)})


def seconds(show: Show, frame: int) -> str:
    """The time of a frame, in words."""
    return f"{show.figures[0].motion.start_time + frame / show.fps:.2f} s"


def _check_size(size: tuple[int, int]) -> None:
    if min(size) < 64 or max(size) > 4096:
        raise ValueError(f"a picture is 64 to 4096 pixels wide and high, got {size}")
