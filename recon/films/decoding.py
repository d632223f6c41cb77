"""Decodes films: upright RGB images with true times, a few at a time however long the film is."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.core.errors import FormatError
from recon.core.limits import FEW_MOMENTS, FRAME_RATE, FRAMES, IMAGE_SIZE
from recon.films.clock import FilmClock, clock_of_stamps
from recon.films.lens import stated_focal_length
from recon.films.shots import Picture, with_shots
from recon.formats.opening import existing_file

if TYPE_CHECKING:
    from av import Packet, VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

_FORMATS = "mov,matroska,webm,avi,mpegts,mpeg,asf,flv,mxf,gif,ogg"
"""FFmpeg's names of formats that hold films; it would open texts, pictures and playlists, too."""
_MAX_SIDE = 4096
"""Longest side (pixels) of the images that are returned; larger films are shrunk."""
_MAX_PIXELS = 5e7
"""Most pixels of a stored picture; 8K has 3.3e7, and a decoder keeps about ten pictures."""
_OTHER_SPEED = 1.5
"""Ratio of the rates of recording and playing from which a film is slow motion or time lapse."""
_THREADS = 2
"""Threads of the decoder, which decode ahead while the caller processes an image."""
_CAPTURE_RATE = "com.android.capture.fps"
"""Name of the metadata item in which phones write the rate of recording."""
_TURNS = {
    90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE
}  # fmt: skip
_TRANSFER_PQ, _TRANSFER_HLG = 16, 18
"""ITU-T H.273's numbers of the transfer functions of films with a high dynamic range."""


@dataclass(frozen=True)
class FilmFrame:
    """One decoded picture of a film, with its time and frame number."""

    image: UInt8[np.ndarray, "height width 3"]
    """RGB, upright as one looks at it, with square pixels."""
    time: float
    """Seconds of the recording since the first picture."""
    number: int
    """Number in the film's even clock, from 0; numbers are missing where the camera dropped a
    frame or a picture repeats the one before."""
    shot: int
    """Number of the shot, from 0, which rises by one at every cut."""


@dataclass
class Film:
    """An opened film; every loop over it decodes it from the beginning."""

    path: Path
    image_size: tuple[int, int]
    """Width and height of the upright film, pixels."""
    shrunk: int
    """Pixels of the film per pixel of an image along each side; 1 up to 4K."""
    turned_by: int
    """Degrees by which the stored pictures are turned clockwise to be upright."""
    clock: FilmClock
    stated_focal: float | None = None
    """Focal length for 35 mm film that the camera wrote, millimetres."""
    notes: list[str] = field(default_factory=list)
    """Assumptions made when opening; damage is added when a loop has reached the end."""
    shots: tuple[int, ...] = ()
    """First frames of all shots but the first, known when a loop has reached the end."""

    @property
    def frame_rate(self) -> float:
        """Frames per second of the clock that numbers the frames."""
        return self.clock.rate

    @property
    def frames(self) -> int:
        """Number of frames of the film's even clock, from the first picture to the last."""
        return self.clock.frames

    def in_film(self, pixels: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2"]:
        """Convert pixels of an image, which may have been shrunk, to pixels of the film."""
        return pixels * self.shrunk + (self.shrunk - 1) / 2

    def in_image(self, pixels: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2"]:
        """Convert pixels of the film to pixels of an image, which may have been shrunk."""
        return (pixels - (self.shrunk - 1) / 2) / self.shrunk

    def __iter__(self) -> Iterator[FilmFrame]:
        """Decode the film; damaged pictures are left out and noted in `notes`."""
        losses: list[str] = []
        last, starts = -1, dict[int, int]()
        for (image, time), shot in with_shots(self._pictures(losses)):
            number = self.clock.number(time)
            if number <= last:
                continue
            last = number
            starts.setdefault(shot, number)
            yield FilmFrame(image, time, number, shot)
        self.shots = tuple(starts.values())[1:]
        self.notes += [note for note in losses if note not in self.notes]

    def _pictures(self, losses: list[str]) -> Iterator[Picture]:
        """Yield upright images and times (s); note in `losses` how many repeats are left out."""
        last, repeated = None, 0
        for frame, time in self.decoded(losses):
            image = self.image_of(frame)
            if last is not None and _equal_images(image, last):
                repeated += 1
                continue
            last = image
            yield image, time
        if repeated:
            losses.append(f"{repeated} pictures that repeat the one before were left out")

    def decoded(self, losses: list[str]) -> Iterator[tuple["VideoFrame", float]]:
        """Yield decoded pictures in FFmpeg's format, repeated ones too, and their times (s).

        The number of damaged pictures is noted in `losses` at the end.
        """
        with _open_film(self.path) as container:
            stream = _video_stream(container, self.path)
            for frame, stamp in _decoded_pictures(container, stream, losses):
                yield frame, self.clock.time(stamp)

    def image_of(self, frame: "VideoFrame") -> UInt8[np.ndarray, "height width 3"]:
        """Convert a picture in FFmpeg's format to an upright RGB image."""
        width, height = (side // self.shrunk for side in self.image_size)
        if self.turned_by % 180 == 90:
            width, height = height, width
        image = frame.to_ndarray(format="rgb24", width=width, height=height, interpolation="AREA")
        if (curve := _tone_curve(int(frame.color_trc))) is not None:
            image = cv2.LUT(image, curve)
        if frame.interlaced_frame:
            rows = image[: height - (height + 1) % 2]
            rows[1::2] = cv2.addWeighted(rows[:-2:2], 0.5, rows[2::2], 0.5, 0.0)
        return image if self.turned_by == 0 else cv2.rotate(image, _TURNS[self.turned_by])


def open_film(path: Path | str, *, frame_rate: float | None = None) -> Film:
    """Open a film and read its time stamps; only its first picture is decoded.

    Args:
        path: file of a film that FFmpeg can decode.
        frame_rate: pictures per second that the camera took, where the film is played at another
            rate and does not tell; None is the rate of its time stamps or of its metadata.

    Raises:
        FileNotFoundError: when there is no such file.
        FormatError: when it is no film, has a single picture, or is damaged from the start.
    """
    path, notes = existing_file(Path(path)), list[str]()
    with _open_film(path) as container:
        stream = _video_stream(container, path)
        stamps = _time_stamps(container, stream)
        recorded = _recorded_rate(container, stream) if frame_rate is None else frame_rate
        promised = stream.frames
    if len(stamps) < 2:
        raise FormatError(
            f"{path}: expected a film of two or more pictures, got {len(stamps)}; a single "
            "picture shows no motion"
        )
    FRAMES.check(len(stamps), path)
    if recorded is not None:
        FRAME_RATE.check(recorded, path)
    played = clock_of_stamps(stamps)
    if (
        frame_rate is None
        and recorded
        and 1 / _OTHER_SPEED < recorded / played.rate < _OTHER_SPEED
    ):
        recorded = None
    clock = played if recorded is None else clock_of_stamps(stamps, recorded)
    FRAME_RATE.check(clock.rate, path)
    FRAMES.check(clock.frames, path, "its time stamps")
    if recorded is not None:
        told = "given" if frame_rate is not None else f"the camera wrote {_CAPTURE_RATE}"
        notes.append(f"recorded at {recorded:g} Hz ({told}), played at {played.rate:.4g} Hz")
    if clock.rate < FEW_MOMENTS:
        notes.append(f"{clock.rate:.3g} pictures per second are too few to follow a motion by")
    if promised > len(stamps):
        notes.append(f"the file ends early: {len(stamps)} of {promised} pictures are there")
    if not clock.is_even:
        notes.append(
            "pictures were taken unevenly: what is seen in them is interpolated at "
            f"{clock.rate:.4g} Hz"
        )
    elif clock.frames > len(stamps):
        notes.append(f"{clock.frames - len(stamps)} of {clock.frames} frames were not recorded")
    return _film_of(path, clock, notes)


def _film_of(path: Path, clock: FilmClock, notes: list[str]) -> Film:
    """Make a `Film`, whose size and rotation are read from its first picture."""
    with _open_film(path) as container:
        stream = _video_stream(container, path)
        found = next(_decoded_pictures(container, stream, []), None)
        aspect = stream.sample_aspect_ratio or Fraction(1)
    if found is None:
        raise FormatError(f"{path}: no picture of it can be decoded; copy or export it again")
    first, _ = found
    width, height = first.width, first.height
    if not 1 / 4 <= aspect <= 4:
        aspect = Fraction(1)
    if aspect != 1:
        width = round(width * aspect)
        notes.append(
            f"pixels are not square ({aspect.numerator}:{aspect.denominator}): pictures of "
            f"{first.width} x {height} become {width} x {height}"
        )
    IMAGE_SIZE.check((width, height), path, "picture")
    turned_by = round(-first.rotation / 90) * 90 % 360
    if turned_by:
        notes.append(f"turned by {turned_by} degrees, as its rotation flag says")
    if first.interlaced_frame:
        notes.append("interlaced: the first field of every picture is used")
    if _tone_curve(int(first.color_trc)) is not None:
        notes.append("of high dynamic range: brightness was mapped to that of a usual film")
    size = (width, height) if turned_by % 180 == 0 else (height, width)
    shrunk = math.ceil(max(size) / _MAX_SIDE)
    if shrunk > 1:
        notes.append(f"looked at in 1/{shrunk} of its size of {size[0]} x {size[1]} pixels")
    focal, said = stated_focal_length(path)
    notes += [said] if said else []
    return Film(path, size, shrunk, turned_by, clock, focal, notes)


@contextmanager
def _open_film(path: Path) -> Iterator["InputContainer"]:
    """Open the container of a film for a `with` block.

    Raises:
        FormatError: when the file is no readable film.
    """
    import av
    from av.error import FFmpegError

    options = {"format_whitelist": _FORMATS}
    try:
        # the prefix keeps colons in names from being taken for protocols
        container = av.open(f"file:{path}", container_options=options, metadata_errors="replace")
    except (FFmpegError, ValueError) as error:
        raise FormatError(f"{path}: expected a film, but {_reason_unreadable(path)}") from error
    with container:
        yield container


def _reason_unreadable(path: Path) -> str:
    """Say why a file cannot be opened as a film, and what the user can do."""
    with path.open("rb") as file:
        unfinished = file.read(12)[4:8] == b"ftyp"
    if unfinished:
        return (
            "its index, which cameras write last, is missing: the recording or the copy was cut "
            "off; copy it again"
        )
    if cv2.haveImageReader(str(path)):
        return "it is a single picture, which shows no motion"
    return "it is none, or damaged; check that a player shows it, and export it as .mp4"


def _video_stream(container: "InputContainer", path: Path) -> "VideoStream":
    """Return the first video stream that is no cover art of music, set up for decoding.

    Raises:
        FormatError: when there is none, or pictures are larger than 8K.
    """
    from av.stream import Disposition

    streams = [
        one for one in container.streams.video if not one.disposition & Disposition.attached_pic
    ]
    if not streams:
        kinds = ", ".join(sorted({one.type for one in container.streams})) or "nothing"
        raise FormatError(f"{path}: expected a film, but the file holds {kinds} without pictures")
    stream = streams[0]
    if stream.codec_context is None:
        raise FormatError(
            f"{path}: its pictures are of an unknown codec, or its index is damaged; check that a "
            "player shows it, and export it as H.264"
        )
    if stream.width * stream.height > _MAX_PIXELS:
        raise FormatError(
            f"{path}: expected pictures of up to 8K, got {stream.width} x {stream.height} "
            "pixels; export it smaller"
        )
    stream.thread_type, stream.codec_context.thread_count = "AUTO", _THREADS
    return stream


def _packets(container: "InputContainer", stream: "VideoStream") -> Iterator["Packet"]:
    """Yield the packets of a stream up to the first that cannot be read."""
    from av.error import FFmpegError

    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except FFmpegError:
            return
        if packet is None:
            return
        if packet.size > 0:
            yield packet


def _has_no_time_stamps(container: "InputContainer") -> bool:
    """Return whether a container stores no time stamps (AVI), so that pictures follow evenly."""
    return container.format.name == "avi"


def _time_stamps(
    container: "InputContainer", stream: "VideoStream"
) -> Float[np.ndarray, " pictures"]:
    """Return the rising time stamps (s) of all pictures that are shown."""
    base, rate = float(stream.time_base or 1), float(stream.average_rate or 25)
    if _has_no_time_stamps(container):
        return np.arange(sum(1 for _ in _packets(container, stream))) / rate
    stamps = [one.pts for one in _packets(container, stream) if not one.is_discard]
    return np.unique([one * base for one in stamps if one is not None])


def _decoded_pictures(
    container: "InputContainer", stream: "VideoStream", losses: list[str]
) -> Iterator[tuple["VideoFrame", float]]:
    """Yield decoded pictures and their time stamps since the first (s).

    Damaged ones are left out; their number is noted in `losses` at the end.
    """
    from av.error import FFmpegError

    base, rate = float(stream.time_base or 1), float(stream.average_rate or 25)
    counted, first, place, damaged = _has_no_time_stamps(container), None, 0, 0
    for packet in chain(_packets(container, stream), (None,)):
        try:
            frames = stream.codec_context.decode(packet)
        except FFmpegError:
            damaged += 1
            continue
        for frame in frames:
            stamp = place / rate if counted else (frame.pts or 0) * base
            place += 1
            first = stamp if first is None else first
            if frame.is_corrupt:
                damaged += 1
            else:
                yield frame, stamp - first
    if damaged:
        losses.append(f"pictures left out because of damage: {damaged}")


def _recorded_rate(container: "InputContainer", stream: "VideoStream") -> float | None:
    """Return the rate of recording (Hz) that a camera wrote into the metadata, or None."""
    text = {**container.metadata, **stream.metadata}.get(_CAPTURE_RATE, "")
    try:
        return float(text) if FRAME_RATE.holds(float(text)) else None
    except ValueError:
        return None


def _equal_images(a: UInt8[np.ndarray, "..."], b: UInt8[np.ndarray, "..."]) -> bool:
    """Return whether two images are equal; for speed, every 16th pixel is compared first."""
    return np.array_equal(a[::16, ::16], b[::16, ::16]) and np.array_equal(a, b)


def _tone_curve(transfer: int) -> UInt8[np.ndarray, " 256"] | None:
    """Return a table from values of high dynamic range to usual ones; None for usual films.

    White paper, 203 cd/m2 (ITU-R BT.2408), becomes white; what is brighter is clipped.
    """
    value = np.linspace(0.0, 1.0, 256)
    if transfer == _TRANSFER_PQ:  # SMPTE ST 2084
        root = value ** (32 / 2523)
        light = 10_000 * (np.maximum(root - 107 / 128, 0) / (2413 / 128 - 2392 / 128 * root)) ** (
            8192 / 1305
        )
        light /= 203
    elif transfer == _TRANSFER_HLG:  # ITU-R BT.2100
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(value <= 0.5, value**2 / 3, (np.exp((value - c) / a) + b) / 12)
        light /= light[191]
    else:
        return None
    return (255 * np.clip(light, 0, 1) ** (1 / 2.2)).round().astype(np.uint8)
