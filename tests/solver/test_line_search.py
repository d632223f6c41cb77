"""Line searches in lock step end at strong-Wolfe points, each in its own time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recon.solver.line_search import LineSearches, WolfeConditions, cubic_minimiser

pytestmark = pytest.mark.numerics


@settings(derandomize=True, deadline=None, max_examples=50)
@given(
    centre=st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=6),
    ripple=st.floats(0.0, 0.3),
)
def test_line_searches_end_at_strong_wolfe_points(centre: list[float], ripple: float) -> None:
    """phi(t) = (1 - t/c)^2 + ripple (1 - cos 9 t/c), whatever the scale c, all in lock step."""
    c = np.array(centre)

    def phi(t: np.ndarray) -> np.ndarray:
        return (1 - t / c) ** 2 + ripple * (1 - np.cos(9 * t / c))

    def slope(t: np.ndarray) -> np.ndarray:
        return (-2 * (1 - t / c) + 9 * ripple * np.sin(9 * t / c)) / c

    wolfe = WolfeConditions(c1=1e-4, c2=0.5, max_trials=60, resolution=0.0)
    searches = LineSearches.create(phi(np.zeros_like(c)))
    origin, origin_slope = phi(np.zeros_like(c)), slope(np.zeros_like(c))
    waiting = np.ones(len(c), dtype=bool)
    for _ in range(60):
        t = searches.step
        verdict = searches.advance(phi(t), slope(t), origin_slope, wolfe)
        done = verdict.finished & waiting
        best = searches.low[0][done]
        at = np.zeros_like(c)
        at[done] = best
        assert (phi(at) <= origin + 1e-4 * at * origin_slope)[done].all()
        assert (np.abs(slope(at)) <= -0.5 * origin_slope)[done].all()
        waiting &= ~done
        if not waiting.any():
            return
    pytest.fail("a line search did not end")


@given(
    st.floats(0.2, 3.0), st.floats(-2.0, 2.0), st.floats(0.1, 2.0), st.floats(-1.0, 1.0),
    st.floats(-2.0, 0.0), st.floats(0.5, 3.0),
)  # fmt: skip
def test_the_minimum_of_a_cubic_is_found_from_any_two_of_its_points(
    k, middle, gap, level, t, span
):
    """φ(t) = k ((t - m)³ / 3 - g² (t - m)) + level has its minimum at m + g."""

    def point(at):
        x = at - middle
        return np.array([[at], [k * (x**3 / 3 - gap**2 * x) + level], [k * (x**2 - gap**2)]])

    a, b = point(middle + gap + t * gap), point(middle + gap + span * gap)
    assert cubic_minimiser(a, b)[0] == pytest.approx(middle + gap, abs=1e-5)
    assert cubic_minimiser(b, a)[0] == pytest.approx(middle + gap, abs=1e-5)
