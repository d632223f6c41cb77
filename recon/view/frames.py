"""Draws images and films of a scene on the processor, without GPU, display or browser."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from recon.formats.replacing import replacing
from recon.view.images import FRAME, ImageRegion, clip_region, close_up_regions, paint_view
from recon.view.lettering import (
    PAPER,
    Picture,
    join,
    line_width,
    save_picture,
    text_size,
    with_legend,
    write_corner_label,
    write_line,
    write_title,
)
from recon.view.painter import frustum, paint
from recon.view.scene import CAMERA, FAINT, WHITE, Show, View
from recon.view.viewpoint import Viewpoint, viewpoints

MAP_SHARE = 0.13
"""Width of the map of a close-up's place in the image, as a share of the picture's width."""


def write_png(
    path: str | Path, *shows: Show, frames: Sequence[int] | None = None, width: int | None = None
) -> None:
    """Write a sheet of pictures: a row for the scene and for each camera, a column per frame.

    All scenes are seen from one place and share the longest legend. Images of cameras are
    squares around the people; a little map shows where in the image they lie.

    Args:
        path: file to write.
        shows: scenes to draw; cameras are those of the first.
        frames: numbers of the frames to draw; None is five evenly spread, six with cameras.
        width: of a single picture, pixels; None is 360, 400 with cameras.

    Raises:
        ValueError: when a frame does not exist, or `width` makes no picture.
        FileNotFoundError: when the folder of `path` does not exist.
    """
    show = shows[0]
    if show.cameras:
        width, wanted = width or 400, 6
        size = (width, 3 * width // 4)
    else:
        width, wanted = width or 360, 5
        size = (width, 11 * width // 9)
    chosen = evenly_spread(show.frames, wanted) if frames is None else frames
    _check_width_and_frames(width, chosen, show.frames)
    stands = viewpoints(show, size)
    rows = [_scene_pictures(one, chosen, stands) for one in shows]
    for view in show.cameras:
        row: list[Picture] = []
        for frame, part in zip(chosen, close_up_regions(show, view, chosen), strict=True):
            row.append(paint_view(show, view, frame, part, width))
            _draw_map(row[-1], view, part)
        _write_camera_name(row[0], view)
        rows.append(row)
    sheet = join([join(row, axis=1) for row in rows], axis=0)
    legend = max((one.legend for one in shows), key=len)
    save_picture(Path(path), with_legend(sheet, legend, text_size(size)))


def write_mp4(path: str | Path, show: Show, width: int | None = None) -> None:
    """Write an H.264 film, one picture per frame at the scene's frame rate.

    Each picture has the scene and, beside it, what every camera sees, above one legend.

    Args:
        path: file to write.
        show: the scene to draw.
        width: of the scene and of each camera's image, pixels; None is 640, 480 with cameras.

    Raises:
        ValueError: when `width` makes no picture.
        FileNotFoundError: when the folder of `path` does not exist.
    """
    parts = [clip_region(show, view) for view in show.cameras]
    width = width or (480 if parts else 640)
    _check_width_and_frames(width, range(show.frames), show.frames)
    size = (width, width + width // 16)
    if parts:
        size = (width, max(min(parts[0].size(width)[1], width), width // 2))
    stands = viewpoints(show, size)
    columns = int(np.ceil(np.sqrt(len(parts) + 1)))

    def picture(frame: int) -> Picture:
        tiles = _scene_pictures(show, [frame], stands)
        for view, part in zip(show.cameras, parts, strict=True):
            tiles.append(paint_view(show, view, frame, part, width))
            _write_camera_name(tiles[-1], view)
        rows = [join(tiles[k : k + columns], axis=1) for k in range(0, len(tiles), columns)]
        text = text_size((width, 3 * width // 4))
        return with_legend(join(rows, axis=0), show.legend, text)

    write_film(Path(path), map(picture, range(show.frames)), show.fps)


def write_film(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """Write pictures of one size as an H.264 film."""
    import av

    with (
        replacing(path) as scratch,
        av.open(str(scratch), "w", format="mp4", options={"movflags": "+faststart"}) as film,
    ):
        stream = film.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.pix_fmt = "yuv420p"
        # takes half as long as preset "medium" with crf 19; at the same size it is 0.5 dB worse
        stream.options = {"crf": "18", "preset": "veryfast"}
        for picture in pictures:
            # H.264 needs even sides, since it stores colours at half resolution
            even = [(0, side % 2) for side in picture.shape[:2]]
            picture = np.pad(picture, (*even, (0, 0)), constant_values=PAPER)
            if stream.width != picture.shape[1]:
                stream.height, stream.width = picture.shape[:2]
            film.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        film.mux(stream.encode(None))


def _scene_pictures(
    show: Show, frames: Sequence[int], views: Sequence[Viewpoint]
) -> list[Picture]:
    """Draw the scene in some frames, with cameras' names and time; the first has a title."""
    row: list[Picture] = []
    for frame in frames:
        picture, view = paint(show, frame, views[frame]), views[frame]
        text, (width, height) = text_size(view.size), view.size
        for camera in show.cameras:
            # write the camera's name above its pyramid
            pixels, depth = view.project(frustum(camera.at(frame)).reshape(-1, 3))
            middle, top = pixels.mean(0), pixels.min(0)[1]
            if depth.min() > 0 and 0 <= middle[0] < width and text < top < height:
                half = line_width(camera.name, text) / 2
                last = max(width - 2 * half - text / 2, text / 2)
                x = np.clip(middle[0] - half, text / 2, last)
                place = (round(float(x)), round(float(top)) - text // 2)
                write_line(picture, camera.name, place, text, colour=CAMERA)
        write_corner_label(
            picture, f"{show.figures[0].motion.start_time + frame / show.fps:.2f} s"
        )
        row.append(picture)
    write_title(row[0], show.title)
    return row


def _write_camera_name(picture: Picture, view: View) -> None:
    """Write a camera's name and the median error of its points on its picture."""
    write_title(picture, view.name)
    if (error := view.median_error) is not None:
        write_corner_label(picture, f"median error {error:.1f} px")


def _draw_map(picture: Picture, view: View, part: ImageRegion) -> None:
    """Draw a map in the lower left corner of which part of the camera's image is shown."""
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


def evenly_spread(count: int, wanted: int) -> list[int]:
    """Choose at most `wanted` of `count` frames, evenly spread from the first to the last."""
    return sorted({round(place) for place in np.linspace(0, count - 1, wanted)})


def _check_width_and_frames(width: int, frames: Sequence[int], count: int) -> None:
    if not 64 <= width <= 2048:
        raise ValueError(f"a picture is 64 to 2048 pixels wide, got {width}")
    if len(frames) == 0 or not all(0 <= frame < count for frame in frames):
        raise ValueError(f"frames must be among 0, ..., {count - 1}, got {list(frames)}")
