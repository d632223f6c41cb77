"""Images and films of a show, drawn on the processor: no GPU, no display, no browser."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from recon.formats.files import replacing
from recon.view.painter import paint
from recon.view.scene import Colour, Show
from recon.view.viewpoint import follow

Picture = UInt8[np.ndarray, "_ _ 3"]

INK: Colour = (38, 42, 50)
FAINT: Colour = (112, 118, 128)
PAPER = 255
REGULAR, BOLD = 400, 650


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
    if frames is None:
        frames = sorted({round(place) for place in np.linspace(0, count - 1, 5)})
    if len(frames) == 0 or not all(0 <= frame < count for frame in frames):
        raise ValueError(f"frames must be among 0, ..., {count - 1}, got {list(frames)}")

    views = follow([figure for show in shows for figure in show.figures], size)
    rows: list[Picture] = []
    for show in shows:
        pictures = [paint(show, frame, views[frame]) for frame in frames]
        text = _text_size(size)
        for frame, picture in zip(frames, pictures, strict=True):
            seconds = f"{show.figures[0].motion.start_time + frame / show.fps:.2f} s"
            _write(picture, seconds, (size[0] - text // 2, size[1] - text // 2), text, right=True)
        _write(pictures[0], show.title, (text // 2, text + text // 2), text * 5 // 4, BOLD, INK)
        rows.append(_join(pictures, axis=1))
    sheet = _join(rows, axis=0)
    entries = dict.fromkeys(entry for show in shows for entry in show.legend)
    sheet = np.concatenate([sheet, _legend(tuple(entries), sheet.shape[1], _text_size(size))])
    with replacing(Path(path)) as scratch:
        written, data = cv2.imencode(".png", sheet[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if not written:
            raise ValueError(f"could not encode a picture of shape {sheet.shape} as PNG")
        scratch.write_bytes(data.tobytes())


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
    import av

    _check_size(size)
    if size[0] % 2 or size[1] % 2:
        raise ValueError(f"a film needs an even width and height, got {size}")
    frames = range(show.frames) if frames is None else frames
    if len(frames) == 0 or not all(0 <= frame < show.frames for frame in frames):
        raise ValueError(f"frames must be among 0, ..., {show.frames - 1}, got {list(frames)}")
    text = _text_size(size)
    legend = _legend(show.legend, size[0], text)
    height = size[1] - len(legend)
    if 2 * height < size[1]:
        raise ValueError(f"a film of {size} has no room beside its legend; make it larger")
    views = follow(show.figures, (size[0], height))
    with (
        replacing(Path(path)) as scratch,
        av.open(str(scratch), "w", format="mp4", options={"movflags": "+faststart"}) as film,
    ):
        stream = film.add_stream("libx264", rate=Fraction(show.fps).limit_denominator(1001))
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "19", "preset": "medium"}
        for frame in frames:
            picture = paint(show, frame, views[frame])
            seconds = f"{show.figures[0].motion.start_time + frame / show.fps:.2f} s"
            _write(picture, show.title, (text, 2 * text), text * 5 // 4, BOLD, INK)
            _write(picture, seconds, (size[0] - text, 2 * text), text, right=True)
            whole = np.concatenate([picture, legend])
            film.mux(stream.encode(av.VideoFrame.from_ndarray(whole, format="rgb24")))
        film.mux(stream.encode(None))


def _check_size(size: tuple[int, int]) -> None:
    if min(size) < 64 or max(size) > 4096:
        raise ValueError(f"a picture is 64 to 4096 pixels wide and high, got {size}")


def _text_size(size: tuple[int, int]) -> int:
    return min(max(10, min(size) // 26), 24)


def _join(pictures: list[Picture], axis: int) -> Picture:
    """Side by side with a thin gap."""
    shape = list(pictures[0].shape)
    shape[axis] = 4
    gap = np.full(shape, PAPER, np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)][1:]
    return np.concatenate(parts, axis)


def _legend(entries: tuple[tuple[str, Colour], ...], width: int, text: int) -> Picture:
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
        _write(picture, word, (x + text * 4 // 3, baseline), text)
        x += _key_width(((word, colour),), text)


def _key_width(entries: tuple[tuple[str, Colour], ...], text: int) -> int:
    return sum(_width(word, text, REGULAR) + text * 17 // 6 for word, _ in entries)


def _write(
    picture: Picture,
    words: str,
    place: tuple[int, int],
    text: int,
    weight: int = REGULAR,
    colour: Colour = FAINT,
    right: bool = False,
) -> None:
    """Write one line whose baseline starts (or, with `right`, ends) at `place`."""
    start = (place[0] - _width(words, text, weight) if right else place[0], place[1])
    cv2.putText(picture, words, start, colour, cv2.FontFace("sans"), text, weight)


def _width(words: str, text: int, weight: int) -> int:
    """Width of a line in pixels, at `text` pixels high."""
    return cv2.getTextSize((0, 0), words, (0, 0), cv2.FontFace("sans"), text, weight)[2]
