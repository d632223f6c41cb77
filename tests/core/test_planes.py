"""Planes in clouds: found, refused and cut away."""

import math

import numpy as np
import pytest

from recon.core.planes import above, clusters, find_ground

pytestmark = pytest.mark.numerics

UP = np.array([0.0, 0.0, 1.0])


def scene(seed=0, tilt=0.2):
    """A tilted floor, a table, a wall and a person-sized heap."""
    g = np.random.default_rng(seed)

    def patch(low, high, count):
        return g.uniform(low, high, (count, 3))

    floor = patch((-2, -2, 0), (2, 2, 0), 4000)
    table = patch((0.5, 0.5, 0.7), (1.9, 1.9, 0.7), 1500)
    wall = patch((-2, 2, 0), (2, 2, 2.5), 6000)
    person = patch((-0.8, -0.8, 0.05), (-0.4, -0.4, 1.75), 1500)
    c, s = math.cos(tilt), math.sin(tilt)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    points = np.concatenate([floor, table, wall, person]) @ turn.T
    return points + g.normal(0, 0.005, points.shape), turn[:, 2]


def test_the_floor_is_found_not_the_wall_nor_the_table():
    points, normal = scene()
    found = find_ground(points, UP)
    assert found.ground is not None
    assert found.ground.normal.numpy() @ normal > math.cos(math.radians(0.5))
    assert float(found.ground.offset) == pytest.approx(0.0, abs=0.01)
    again = find_ground(points, UP)
    assert np.array_equal(again.ground.coefficients, found.ground.coefficients)  # type: ignore[union-attr]


def test_what_stands_on_the_ground_comes_apart():
    points, _ = scene()
    ground = find_ground(points, UP).ground
    assert ground is not None
    kept = points[above(points, ground)]
    assert 8000 < len(kept) < 9200
    person = kept[np.linalg.norm(kept[:, :2] + 0.6, axis=1) < 0.7]
    heap = np.concatenate([person, person[:200] + 3.0])
    assert (clusters(heap)[: len(person)] == 0).all()
    assert (clusters(heap)[len(person) :] > 0).all()


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.zeros((0, 3)), "no plane"),
        (np.ones((50, 3)), "no plane"),
        (np.random.default_rng(0).normal(0, 1, (2000, 3)) * (0.02, 2, 2), "from level"),
        (np.random.default_rng(0).normal(0, 1, (2000, 3)) * (0.5, 0.1, 0.01), "wider than a body"),
    ],
)
def test_no_ground_is_said_with_its_reason(points, reason):
    found = find_ground(points, UP)
    assert found.ground is None
    assert reason in found.reason


def test_nan_is_refused():
    with pytest.raises(ValueError, match="NaN"):
        find_ground(np.full((5, 3), np.nan), UP)
