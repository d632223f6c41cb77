"""`recon stream`: frames as lines of JSON in, estimates as lines of JSON out."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.live.links import Link
from recon.live.moments import MomentLike
from recon.live.stream import Stream
from recon.live.tracking import LiveEstimate

DIGITS = 6
"""Decimals of numbers in lines: micrometres and microradians."""


def stream_lines(
    lines: Iterable[str],
    stream: Stream,
    complain: Callable[[str], None],
    links: Sequence[Link] = (),
) -> Iterator[str]:
    """Yield a line of JSON for every estimate of a stream, as soon as it is final.

    An input line that does not hold a moment is reported and skipped.

    Args:
        lines: one JSON object each: `points`, a row of three numbers per point, null where it was
            not seen (of several sensors, a list of such rows); and `time`, seconds, unless each
            moment is one frame after the last. Blank lines are skipped.
        stream: with a template.
        complain: called with a message for every line that does not hold a moment.
        links: every estimate is sent to them, too.
    """
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            points, time = _parsed_line(line)
            estimate = stream.push(points, time)
        except ReconError as error:
            complain(f"line {number}: {error}")
            continue
        for link in links:
            link.send(estimate)
        if estimate is not None:
            yield from _json_lines(estimate)
    for estimate in stream.finish():
        for link in links:
            link.send(estimate)
        yield from _json_lines(estimate)
    for link in links:
        link.send(None)


def _parsed_line(line: str) -> tuple[MomentLike, float | None]:
    """Return the points, and the time in seconds if stated, of one line of JSON.

    Raises:
        ReconError: when the line does not hold a moment.
    """
    try:
        moment = json.loads(line)
        points, time = moment["points"], moment.get("time")
        several = any(_holds_points(one) for one in points)
        arrays = [_points_array(one) for one in points] if several else _points_array(points)
        return arrays, None if time is None else float(str(time))  # float("True") raises
    except Exception as error:  # the caller reports the bad line, and goes on
        raise ReconError(
            'expected {"points": [[x, y, z], null, ...], "time": seconds}, got '
            f"{line.strip()[:60]!r} ({error!s:.80})"
        ) from error


def _holds_points(value: Any) -> bool:
    """Return whether a JSON value holds all points of one sensor, not a single point."""
    return isinstance(value, list) and any(
        isinstance(one, list) or (one is None and len(value) > 3) for one in value
    )


def _points_array(rows: Any) -> np.ndarray:
    """Return an array (points, 3) of JSON rows; null, or a row with null in it, becomes NaN."""
    return np.array(
        [
            [np.nan] * 3 if row is None or (isinstance(row, list) and None in row) else row
            for row in rows
        ],
        dtype=float,
    )


def _json_lines(estimate: LiveEstimate) -> Iterator[str]:
    for one in estimate.every:
        poses = so3.log(one.rotations.double())
        fields: dict[str, Any] = {
            "time": round(one.time, DIGITS),
            "trans": _rounded(one.translation),
            "poses": _rounded(poses.flatten()),
            "joints": _rounded(one.joints),
            "betas": _rounded(one.shape),
            "observed": one.observed.int().tolist(),
        }
        if one.contacts is not None:
            fields["contacts"] = _rounded(one.contacts)
        if one is estimate and estimate.findings:
            fields["findings"] = [
                {"code": finding.code, "message": finding.message} for finding in estimate.findings
            ]
        yield json.dumps(fields)


def _rounded(values: Any) -> Any:
    return np.round(values.double().numpy(), DIGITS).tolist()
