"""Reads the times of scans from a table, and assigns them to evenly spaced frames."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import FormatError
from recon.core.limits import FRAME_RATE, TIME
from recon.formats.json_files import frame_numbers, last_numbers
from recon.formats.texts import decoded_text, read_bytes

MAX_OFF_FRAMES = 0.25
"""Part of a frame by which a time may be off a whole one, as times rounded to milliseconds are."""
_EVEN_FRAMES = 0.2
"""Greatest distance of scan times from an even clock, in frames of the clock."""
_EVEN_SECONDS = 0.007
"""Greatest distance of scan times from an even clock in seconds, in which a foot moves 2 cm."""
_NEAR, _FINEST = 0.0025, 200.0
"""Greatest distance, seconds, of uneven scan times from the frames of the clock that they are put
on, and its greatest rate, Hz: at that rate every time is so near to a frame."""
_LONGEST = 60.0
"""Longest recording, seconds, whose scans may be unevenly timed."""
_EMPTY, _SHORT = 8, 20_000
"""Most frames of a clock per frame with data, and number of frames that is always allowed: empty
frames take memory, too."""
_USUAL_RATES, _TICKS = (4.0, 500.0), (1e3, 1e6, 1e9)
"""Rates of recordings, Hz, and how many milli-, micro- and nanoseconds a second has."""
_SLOWEST = 0.125
"""Rate of scans, Hz, from which on they show a motion: at it, a person walks 10 m between two."""
_PARTS = {"": 1.0, "m": 1e3, "milli": 1e3, "u": 1e6, "micro": 1e6, "n": 1e9, "nano": 1e9}
_UNIT = re.compile(r"(?:^|[^a-z])(milli|micro|nano|[mun]|)s(?:ec(?:ond)?s?)?[)\]]?$")
"""Matches a unit of time at the end of a heading: time_ms, seconds, t [us]."""
_SECONDS = re.compile(r"(\d{1,10})(\.|(?<=\d{9})_)(\d{1,9})")
"""Matches names with a time: 0.667, or 1617012345_900000000 of seconds and nanoseconds."""
_OFF_RATE = 0.05
"""Share by which the frame rate of times in names may differ from the given one."""


def ticks_per_second(rate: float, slowest: float = _USUAL_RATES[0]) -> float:
    """Return how many units of time are a second, by how many frames there are in one unit.

    That is 1 for `slowest` or more frames; else 1e3, 1e6 or 1e9, the first with which the frame
    rate is usual; 0 if it is with none.
    """
    low, high = _USUAL_RATES
    usual = (ticks for ticks in _TICKS if low <= rate * ticks <= high)
    return 1.0 if rate >= slowest else next(usual, 0.0)


def frames_of_even_times(times: Float[np.ndarray, " rows"]) -> Int[np.ndarray, " rows"] | None:
    """Convert times to frame numbers, one per median step; None if a step is no multiple of it.

    A step may be off its multiple by a quarter of the median step.
    """
    steps = np.diff(times)
    ratio = steps / max(float(np.median(steps)), 1e-300) if len(steps) > 0 else steps
    whole = np.rint(ratio)
    fits = (np.abs(ratio - whole) <= MAX_OFF_FRAMES).all() and (whole >= 1).all()
    return np.concatenate(([0], np.cumsum(whole))).astype(np.int64) if fits else None


def common_step(numbers: Int[np.ndarray, " numbers"]) -> int:
    """Return the greatest common divisor of all differences of numbers; 1 if all are equal."""
    return max(int(np.gcd.reduce(numbers - numbers[:1])), 1)


def consecutive_numbers(
    numbers: Sequence[int] | np.ndarray,
) -> tuple[Int[np.ndarray, " numbers"], tuple[str, ...]]:
    """Renumber rising frame numbers from 0, dividing by the greatest common divisor of the steps.

    So 10, 12, 14, 18 become 0, 1, 2, 4, and the sentence that is returned besides says so.
    """
    ticks = np.minimum(numbers, 2.0**62).astype(np.int64)
    step = common_step(ticks)
    note = (
        f"frame numbers that step by {step} are taken as consecutive frames: the frame rate is "
        "that of these frames, not of the film that also has those between them"
    )
    return (ticks - ticks[:1]) // step, (note,) if step > 1 else ()


def frames_of_names(
    files: list[Path], fps: float
) -> tuple[list[Path], Int[np.ndarray, " files"], list[str]]:
    """Return files in the order of time, the frame of each by its name, and notes about them.

    Names have frame numbers, or times at this frame rate: seconds with decimals and nothing else,
    seconds_nanoseconds, or milli-, micro- or nanoseconds. Others, not rising, are consecutive.

    Raises:
        ValueError: when files have the same number, or times of another frame rate.
    """
    stems, folder = [file.stem for file in files], files[0].parent
    parts = [m for one in stems if (m := _SECONDS.fullmatch(one))]
    times = np.array([float(f"{m[1]}.{m[3].zfill(9 if m[2] == '_' else 1)}") for m in parts])
    found, said = None, ()
    if len(times) == len(files) > 1:
        order = np.argsort(times, kind="stable")
        steps = np.diff(times[order])
        if (found := _frames_of_steps(steps * fps)) is not None:
            files = [files[k] for k in order]
        elif len({m[1] for m in parts}) > 1:
            raise FormatError(
                f"{folder}: by names, files are {np.median(steps):.4g} s apart, which does not "
                f"fit {fps:g} frames per second: give their rate, or times in times.csv"
            )
    if found is None and None not in (numbers := set(last_numbers(stems))) and len(numbers) > 1:
        found, said = _frames_of_numbers(np.array(frame_numbers(stems, str(folder))), fps, folder)
    if found is None or (np.diff(found) < 1).any() or not fits_memory(int(found[-1]), len(files)):
        said = ("the names of the files do not number frames: taken as consecutive ones",)
        return files, np.arange(len(files)), list(said)
    missing = int(found[-1]) + 1 - len(files)
    told = f"{missing} frames are missing between others, by the files' names: left empty"
    return files, found, [*said, told] if missing else [*said]


def _frames_of_numbers(
    numbers: Int[np.ndarray, " files"], fps: float, folder: Path
) -> tuple[Int[np.ndarray, " files"], tuple[str, ...]]:
    """Convert numbers in names to frames: they count frames, or ticks of a known clock.

    Raises:
        ValueError: when they rise evenly as a clock's do, but by none that is known.
    """
    found, said = consecutive_numbers(numbers)
    steps = np.diff(numbers)
    if np.median(np.diff(found)) <= 1:
        return found, said
    for ticks in (*_TICKS, 1e7):  # Windows counts 100 ns
        clock = _frames_of_steps(steps * fps / ticks)
        if clock is not None and np.median(np.diff(clock)) < 2:
            return clock, (f"the numbers in names are taken as times, {ticks:g} in a second",)
    if np.median(np.diff(found)) >= _EMPTY and frames_of_even_times(numbers * 1.0) is not None:
        raise FormatError(
            f"{folder}: the numbers in names rise by about {np.median(steps):g}, as times do, but "
            f"not by milli-, micro- or nanoseconds at {fps:g} frames per second: give the rate of "
            "the files, or their times in times.csv"
        )
    return found, said


def _frames_of_steps(steps: Float[np.ndarray, " steps"]) -> Int[np.ndarray, " files"] | None:
    """Add up the steps of a clock, in frames; None if some are not whole, or the rate is wrong."""
    whole = np.rint(steps)
    near = np.abs(steps - whole) <= np.maximum(MAX_OFF_FRAMES, _OFF_RATE * whole)
    rate_off = abs(steps.sum() - whole.sum()) - max(2 * MAX_OFF_FRAMES, _OFF_RATE * whole.sum())
    fits = near.all() and (whole >= 1).all() and rate_off <= 0
    return np.concatenate(([0], np.cumsum(whole))).astype(np.int64) if fits else None


@dataclass(frozen=True)
class TimedScans:
    """Scan files in the order of their times, each with a frame number."""

    files: list[Path]
    frames: Int[np.ndarray, " files"]
    """Frames of the clock, from 0."""
    decisions: list[str]
    """What was assumed, in sentences."""
    fps: float
    start_time: float = 0.0
    """Time of frame 0, seconds."""


def clock_of_files(folder: Path, files: list[Path], fps: float | None) -> TimedScans:
    """Number files of one frame each by the folder's times.csv, else by names at a frame rate.

    Raises:
        ValueError: when there is neither a times.csv nor a frame rate, or one is implausible.
    """
    if (times := folder / "times.csv").exists():
        return in_time_order(times, files)
    if fps is None:
        raise FormatError(
            f"{folder}: expected times.csv with the times of its files; give frames per second "
            "with --frame-rate"
        )
    FRAME_RATE.check(fps, folder, "frame rate")
    return TimedScans(*frames_of_names(files, fps), fps=fps)


def in_time_order(path: Path, files: list[Path]) -> TimedScans:
    """Order scan files by the times in a table, which may name them in any order.

    Raises:
        ValueError: when a time is missing, twice the same, or times of unnamed files do not rise.
    """
    times, named, decisions = read_times(path, files)
    TIME.check(times, path, "time")
    order = np.argsort(times, kind="stable")
    if named and not np.array_equal(order, np.arange(len(files))):
        decisions.append(f"{path.name} has the files in another order than their names")
        files, times = [files[k] for k in order], times[order]
    frames, fps, start = frame_numbers_of_times(times, path)
    decisions += note_on_empty_frames(times, frames, fps)
    return TimedScans(files, frames, decisions, fps, start)


def read_times(
    path: Path, files: list[Path]
) -> tuple[Float[np.ndarray, " files"], bool, list[str]]:
    """Read the time of every file, seconds, whether the lines name files, and a note on the unit.

    A heading may end in the unit of the times (time_ms); else they are seconds, or the finer unit
    in which they are of a usual rate where seconds would be too slow to show a motion.

    Raises:
        ValueError: when a file has no time, the lines are of another kind, or the unit is unknown.
    """
    rows = [
        re.split(r"[,;\s]+", line.strip()) for line in decoded_text(read_bytes(path)).splitlines()
    ]
    rows = [row for row in rows if row != [""]]
    heading = rows.pop(0)[-1].lower() if rows and not _is_number(rows[0][-1]) else ""
    if heading.startswith("frame"):
        raise FormatError(f"{path}: expected times in seconds, got the column {heading!r}")
    if not all(len(row) in (1, 2) and _is_number(row[-1]) for row in rows):
        raise FormatError(f"{path}: expected a line per file, its time in s, or its name and time")
    if named := any(len(row) == 2 for row in rows):
        time_of = {Path(row[0]).name: float(row[-1]) for row in rows}
        if len(time_of) < len({(Path(row[0]).name, float(row[-1])) for row in rows}):
            raise FormatError(f"{path}: expected one time for every file, got several for some")
        if missing := [file.name for file in files if file.name not in time_of]:
            raise FormatError(f"{path}: has no time for {', '.join(missing[:5])}")
        times = np.array([time_of[file.name] for file in files])
    elif len(rows) != len(files):
        raise FormatError(f"{path}: expected {len(files)} times, one per file, got {len(rows)}")
    else:
        times = np.array([float(row[0]) for row in rows])
    ticks = _ticks_of_times(np.sort(times), heading, path)
    said = f"{path.name} counts {ticks:g} in a second, by its heading or the size of its steps"
    return times / ticks, named, [said] if ticks != 1 else []


def _ticks_of_times(times: Float[np.ndarray, " files"], heading: str, path: Path) -> float:
    """Return how many units of rising times are a second, by the heading of their column or size.

    Raises:
        ValueError: when the heading names no unit and the times are too far apart for any.
    """
    if (unit := _UNIT.search(heading)) is not None:
        return _PARTS[unit[1]]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if not (ticks := ticks_per_second(1 / max(step, 1e-300), _SLOWEST)):
        raise FormatError(
            f"{path}: half of the times are {step:g} or more apart: as seconds, they show no "
            "motion; expected seconds, or the unit in its heading: file,time_ms"
        )
    return ticks


def frame_numbers_of_times(
    times: Float[np.ndarray, " files"], path: Path
) -> tuple[np.ndarray, float, float]:
    """Put times (s) on an even clock; return frame numbers, frame rate (Hz) and first time (s).

    For scans that are evenly timed but for dropped ones, that is their own clock; for others it
    is the slowest clock that has a frame near each time, and no two times at one frame.

    Raises:
        ValueError: when the times do not rise, or are unevenly spaced for too long.
    """
    if len(times) < 2 or not np.isfinite(times).all():
        raise FormatError(
            f"{path}: a single scan has no motion; expected two or more times in seconds, got "
            f"{len(times)}"
        )
    steps = np.diff(times)
    if not (steps > 0).all():
        row = int((steps <= 0).argmax())
        raise FormatError(
            f"{path}: expected rising times in seconds, no two alike; got {times[row]:g} and then "
            f"{times[row + 1]:g}. Where files are not in the order of their names, give a line of "
            "name and time for each"
        )
    span, step = float(times[-1] - times[0]), float(np.median(steps))
    FRAME_RATE.check(1 / max(step, 1e-300), path, "half of the times")
    count = max(round(span / step), 1)
    if span > _LONGEST and not fits_memory(count, len(times)):
        row = int(steps.argmax())
        raise FormatError(
            f"{path}: only {len(times)} of {count} frames have a scan, and none follows for "
            f"{steps[row]:.6g} s after {times[row]:.6g} s; cut the recording there"
        )
    off = _largest_deviation(times, count)
    close = off * span / count <= _EVEN_SECONDS or span > _LONGEST
    if off <= _EVEN_FRAMES and close and _nearest_steps_differ(times, count):
        return _nearest_steps(times, count), count / span, float(times[0])
    if span > _LONGEST:
        raise FormatError(
            f"{path}: the times are not evenly spaced (up to {off:.2f} frames off); recordings "
            f"longer than {_LONGEST:g} s need even spacing, so resample first"
        )
    if float(steps.min()) < 1 / _FINEST:
        raise FormatError(
            f"{path}: two scans are only {1000 * float(steps.min()):.2g} ms apart, and the others "
            f"are not evenly spaced; leave one of the two out"
        )
    finest = math.ceil(span * _FINEST)
    for count in range(len(times) - 1, finest):
        if _largest_deviation(times, count) * span / count <= _NEAR and _nearest_steps_differ(
            times, count
        ):
            return _nearest_steps(times, count), count / span, float(times[0])
    return _nearest_steps(times, finest), finest / span, float(times[0])


def fits_memory(frames: int, nonempty: int) -> bool:
    """Whether a recording of `frames` frames, of which `nonempty` have data, fits into memory."""
    return frames <= max(_EMPTY * nonempty, _SHORT)


def note_on_empty_frames(
    times: Float[np.ndarray, " files"], frames: Int[np.ndarray, " files"], fps: float
) -> list[str]:
    """Return a list with a note if most frames of a recording are empty, else an empty one."""
    if 2 * len(frames) > int(frames[-1]) + 1:
        return []
    off = float(np.abs(times - times[0] - frames / fps).max())
    return [
        f"{len(frames)} scans are on a clock of {fps:.4g} Hz, at most {1000 * off:.1f} ms off; "
        "its other frames are empty"
    ]


def _nearest_steps(times: Float[np.ndarray, " files"], count: int) -> Int[np.ndarray, " files"]:
    """Return the number of each time's nearest step, of `count` equal steps from first to last."""
    return np.rint((times - times[0]) / (times[-1] - times[0]) * count).astype(np.int64)


def _nearest_steps_differ(times: Float[np.ndarray, " files"], count: int) -> bool:
    """Whether no two times have the same nearest step among `count` evenly spaced ones."""
    return bool((np.diff(_nearest_steps(times, count)) > 0).all())


def _largest_deviation(times: Float[np.ndarray, " files"], count: int) -> float:
    """Return the largest distance of a time from the nearest of `count` even steps, in steps."""
    place = (times - times[0]) / (times[-1] - times[0]) * count
    return float(np.abs(place - place.round()).max())


def _is_number(text: str) -> bool:
    try:
        return np.isfinite(float(text)).item()
    except ValueError:
        return False


@dataclass(frozen=True)
class PointClock:
    """Frame numbers of points, with frame rate and start time."""

    frame: Int[np.ndarray, " points"]
    """The frame of each point, from 0."""
    fps: float
    start_time: float
    """Time of frame 0, seconds."""
    decisions: tuple[str, ...] = ()
    """What was changed, in sentences."""


def compact_clock(
    frame: Int[np.ndarray, " points"], fps: float, start_time: float, path: Path
) -> PointClock:
    """Renumber the frames of points if nearly all numbers between the first and last are unused.

    Numbers that are close to each other stay as they are. Others are counted from the first one
    and by their greatest common divisor, which changes no time; where that does not help, their
    times are put on an even clock as those of scans are (`frame_numbers_of_times`).

    Raises:
        ValueError: when no clock fits them, because of a long gap or because two are closer than
            frames of any camera.
    """
    numbers, place = np.unique(frame, return_inverse=True)
    if fits_memory(int(numbers[-1]) + 1, len(numbers)):
        FRAME_RATE.check(fps, path, "fps")
        return PointClock(frame, fps, start_time)
    step = common_step(numbers)
    ticks, rate, start = (
        (numbers - numbers[0]) // step,
        fps / step,
        start_time + float(numbers[0]) / fps,
    )
    if not fits_memory(int(ticks[-1]) + 1, len(ticks)):
        ticks, rate, _ = frame_numbers_of_times(ticks / rate, path)
    FRAME_RATE.check(rate, path, "fps and frame")
    note = (
        f"frame numbers {numbers[0]} to {numbers[-1]} at {fps:g} Hz are those of a clock: "
        f"{len(numbers)} frames with points were put on one of {rate:.4g} Hz"
    )
    return PointClock(ticks[place.reshape(-1)], rate, start, (note,))
