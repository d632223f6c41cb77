"""Intervals of means: what they must be where the answer is known."""

import numpy as np
import pytest

from recon.benchmark.table import mean_with_interval, paired_difference


def test_equal_values_leave_no_doubt() -> None:
    found = mean_with_interval([2.0] * 6, list("abcdef"), ["x"] * 3 + ["y"] * 3)
    assert (found.mean, found.low, found.high) == (2.0, 2.0, 2.0)


def test_subjects_count_alike_however_many_windows_they_have() -> None:
    found = mean_with_interval(
        [1.0] * 9 + [3.0], [f"a{i}" for i in range(9)] + ["b"], ["x"] * 9 + ["y"]
    )
    assert found.mean == 2.0


def test_many_clips_give_the_interval_of_the_central_limit_theorem() -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    found = mean_with_interval(values.tolist(), [str(i) for i in range(400)], ["x"] * 400)
    half = 1.96 * values.std() / 20
    assert found.mean == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.03)
    assert found.high == pytest.approx(values.mean() + half, abs=0.03)


def test_windows_of_one_clip_are_drawn_together() -> None:
    """Ten copies of each clip are no more knowledge than one."""
    values = np.random.default_rng(2).normal(0.0, 1.0, 30)
    once = mean_with_interval(values.tolist(), [str(i) for i in range(30)], ["x"] * 30)
    tenfold = mean_with_interval(
        np.repeat(values, 10).tolist(), np.repeat(range(30), 10).astype(str).tolist(), ["x"] * 300
    )
    assert tenfold.low == pytest.approx(once.low)
    assert tenfold.high == pytest.approx(once.high)


def test_intervals_cover_the_true_mean_about_as_often_as_they_say() -> None:
    random = np.random.default_rng(3)
    clips, subjects = [str(i) for i in range(40)], ["x"] * 20 + ["y"] * 20
    hits = 0
    for _ in range(100):
        found = mean_with_interval(random.normal(1.0, 1.0, 40).tolist(), clips, subjects)
        hits += found.low <= 1.0 <= found.high
    assert 86 <= hits <= 100


def test_paired_differences_see_what_separate_intervals_do_not() -> None:
    random = np.random.default_rng(4)
    easy = random.uniform(1.0, 10.0, 30)
    better, clips, subjects = easy - 0.2, [str(i) for i in range(30)], ["x"] * 30
    one, other = (mean_with_interval(v.tolist(), clips, subjects) for v in (easy, better))
    assert one.low < other.high  # the separate intervals overlap
    found = paired_difference(better.tolist(), easy.tolist(), clips, subjects)
    assert found.mean == pytest.approx(-0.2)
    assert found.excludes_zero
    noise = random.normal(0.0, 1.0, 30)
    assert not paired_difference(noise.tolist(), (-noise).tolist(), clips, subjects).excludes_zero


def test_windows_without_a_value_are_left_out() -> None:
    found = mean_with_interval([1.0, None, 3.0], ["a", "b", "c"], ["x", "x", "x"])
    assert found.mean == 2.0
    assert paired_difference([1.0, None], [0.5, 7.0], ["a", "b"], ["x", "x"]).mean == 0.5


def test_what_cannot_be_averaged_is_refused() -> None:
    with pytest.raises(ValueError, match="in at least one window"):
        mean_with_interval([None], ["a"], ["x"])
    with pytest.raises(ValueError, match="one clip and one subject per value"):
        mean_with_interval([1.0, 2.0], ["a"], ["x"])
    with pytest.raises(ValueError, match="same windows"):
        paired_difference([1.0], [1.0, 2.0], ["a"], ["x"])
