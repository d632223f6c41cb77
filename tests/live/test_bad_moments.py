"""Streams go on whatever is pushed into them, or written on their lines."""

import json

import numpy as np
import pytest
import torch

import recon
from recon.live.lines import stream_lines
from tests.live.conftest import FPS, FRAMES, codes, joints_of, played, stream

LINES = (
    "[" * 100_000, '{"points": ' + "[" * 100_000, '{"time": 1' + "0" * 400 + ', "points": []}',
    "null", "7", '"points"', "[]", "{}", '{"points": null}', '{"points": 3}', '{"points": "a"}',
    '{"points": [[1, 2, 3]]}', '{"points": {}}', '{"points": [[1e400, 0, 0]]}', "NaN", "\x00",
    '{"points": [], "time": "soon"}', '{"points": [], "time": true}', '{"points": [[["x"]]]}',
    '{"time": 1}', "9" * 5000, "{" * 999, "\ufffd" * 50,
)  # fmt: skip
"""What is no moment, whatever it is."""


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_garbage_between_moments_changes_no_estimate(seen):
    """One line of brackets ended the stream, and the last moments were lost."""
    good = [json.dumps({"points": row.tolist(), "time": k / FPS}) for k, row in enumerate(seen)]
    mixed = [
        line
        for k, moment in enumerate(good)
        for line in (moment, *(LINES[(3 * k + j) % len(LINES)] for j in range(3)))
    ]
    told: list[str] = []
    clean = list(stream_lines(good, stream(lag=4), told.append))
    assert told == []
    assert list(stream_lines(mixed, stream(lag=4), told.append)) == clean
    assert len(told) == 3 * len(good)
    assert len(clean) == len(good)


def test_values_that_are_no_moments_are_refused_alike(seen):
    live, found = stream(lag=4), []
    bad = [
        (1000 * seen[0], None), (seen[0], float("nan")), (seen[0], -1e400), ("x", None),
        (seen[0][:5], None), (np.full((22, 3), np.inf), 1e400), ([None] * 22, None), ([], None),
        (seen[0].astype(object), float("inf")), (b"", None), ([[[["x"]]]], None),
        (torch.zeros(22, 3, dtype=torch.complex64), None),
    ]  # fmt: skip
    for k, moment in enumerate(seen):
        for given, time in bad[k % 3 :: 3]:
            if given is not seen[0] or time is not None:
                with pytest.raises(recon.ObservationError):
                    live.push(given, time)  # pyright: ignore[reportArgumentType]
        estimate = live.push(moment, k / FPS)
        found += () if estimate is None else estimate.every
    found += live.finish()
    torch.testing.assert_close(joints_of(found), joints_of(played(stream(lag=4), seen)))


@pytest.mark.slow
def test_a_thousand_bad_moments_among_five_thousand(seen):
    """No line and no value ends the stream, and every good moment has its estimate."""
    random, live, told = np.random.default_rng(0), stream(lag=0), list[str]()
    values = ("x", [None], [], b"", 1000 * seen[0], seen[0][:5], np.zeros((22, 3, 1)))

    def lines():
        for k in range(5000):
            line = json.dumps({"points": seen[k % FRAMES].round(4).tolist(), "time": k / FPS})
            yield line
            if k % 20 == 3:
                yield line[: random.integers(1, len(line))]
            if k % 20 == 13:
                yield LINES[k % len(LINES)]
            if k % 10 == 7:
                with pytest.raises(recon.ObservationError):
                    live.push(values[k % len(values)], None)

    found = [json.loads(line)["time"] for line in stream_lines(lines(), live, told.append)]
    assert found == pytest.approx([k / FPS for k in range(5000)], abs=1e-5)
    assert len(told) == 500


def test_times_in_milliseconds_are_refused(seen):
    """Every moment was a jump of the clock: no estimate came, and no word."""
    live = stream(lag=4)
    assert live.push(seen[0], 0.0) is None
    assert live.push(seen[1], 33.3) is None
    with pytest.raises(recon.ObservationError, match="divide milliseconds by 1000"):
        live.push(seen[2], 66.7)


def test_moments_with_another_axis_up_are_told(seen):
    turned = seen[..., [0, 2, 1]] * np.float32([1, 1, -1]) - np.float32([0, 0, 1])
    assert "floor" in codes(played(stream(lag=4), turned))
    assert "floor" not in codes(played(stream(lag=4), seen))
