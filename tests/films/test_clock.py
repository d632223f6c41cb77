"""Keypoints of unevenly taken pictures, at even times."""

import numpy as np
import pytest

from recon.films.clock import clock_of_stamps, resampled_at_even_times


def rows_at(stamps, rate):
    """One keypoint that moves at 300 pixels per second, at the nearest frames of the clock."""
    numbers = np.rint(stamps * rate).astype(int)
    kept = np.unique(numbers, return_index=True)[1]
    rows = [(int(numbers[k]), np.array([[300 * stamps[k], 5.0, 0.9]]), 3) for k in kept]
    return rows, {int(numbers[k]): float(stamps[k]) for k in kept}


def test_a_steady_motion_stays_steady():
    """At the nearest frames of the clock, it went up to half a frame's way forth and back."""
    stamps = np.append(0.0, np.cumsum(np.random.default_rng(0).uniform(0.025, 0.045, 60)))
    clock = clock_of_stamps(stamps)
    assert not clock.is_even
    rows, times = rows_at(stamps, clock.rate)
    even = resampled_at_even_times(rows, times, clock.rate)
    assert [number for number, _, _ in even] == list(range(even[0][0], even[-1][0] + 1))
    for number, keypoints, person in even:
        assert keypoints[0] == pytest.approx((300 * number / clock.rate, 5.0, 0.9), abs=1.3)
        assert person == 3


def test_nothing_is_invented_in_a_pause():
    stamps = np.append(np.arange(10), np.arange(19, 30)) / 30
    rows, times = rows_at(stamps, 30.0)
    assert [row[0] for row in resampled_at_even_times(rows, times, 30.0)] == [
        *range(10),
        *range(19, 30),
    ]


def test_a_keypoint_is_as_sure_as_the_less_sure_of_two_pictures():
    rows = [(0, np.array([[0.0, 1.0, 0.9]]), 0), (2, np.array([[2.0, 1.0, 0.0]]), 0)]
    sure = [row[1][0, 2] for row in resampled_at_even_times(rows, {0: 0.0, 2: 0.2}, 10.0)]
    assert sure == [0.9, 0.0, 0.0]
