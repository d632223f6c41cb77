"""Planes in clouds: found, refused and cut away."""

import math

import numpy as np
import pytest

from recon.core.planes import above_ground, cluster_numbers, find_ground, find_walls

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
    found = find_ground([points], UP)
    assert found.ground is not None
    assert found.ground.normal.numpy() @ normal > math.cos(math.radians(0.5))
    assert float(found.ground.offset) == pytest.approx(0.0, abs=0.01)
    again = find_ground([points], UP)
    assert np.array_equal(again.ground.coefficients, found.ground.coefficients)  # type: ignore[union-attr]


def test_what_stands_on_the_ground_comes_apart():
    points, _ = scene()
    ground = find_ground([points], UP).ground
    assert ground is not None
    kept = points[above_ground(points, ground)]
    assert 8000 < len(kept) < 9200
    person = kept[np.linalg.norm(kept[:, :2] + 0.6, axis=1) < 0.7]
    heap = np.concatenate([person, person[:200] + 3.0])
    assert (cluster_numbers(heap)[: len(person)] == 0).all()
    assert (cluster_numbers(heap)[len(person) :] > 0).all()


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
    found = find_ground([points], UP)
    assert found.ground is None
    assert found.reason.startswith("no ground is seen in the points")
    assert reason in found.reason


def test_nan_is_refused():
    with pytest.raises(ValueError, match="NaN"):
        find_ground([np.full((5, 3), np.nan)], UP)


def passing(people=(0.0,), frames=30, speed=1.3):
    """Boxes of a person's size, some metres behind each other, that go along x at 10 Hz."""
    g = np.random.default_rng(3)
    start = np.array([[[x, 0.0, 0.0]] for x in people])
    bodies = g.uniform((-0.25, -0.1, 0), (0.25, 0.1, 1.7), (frames, len(people), 300, 3)) + start
    way = speed * np.arange(frames)[:, None, None] / 10 * np.array([1.0, 0.0, 0.0])
    return list(bodies.reshape(frames, -1, 3) + way)


def wall_at(y, left=-3.0, right=3.0, count=1500):
    return np.random.default_rng(4).uniform((left, y, 0), (right, y, 2.5), (count, 3))


@pytest.mark.parametrize("people", [(0.0,), (0.0, 2.0)])
def test_who_walks_straight_is_no_wall(people):
    """Points of all frames were searched together: the body sweeps a plane as wide as a wall."""
    assert find_walls(passing(people), np.array([2.0, -3.0, 1.5])) == []


def test_a_wall_behind_a_walker_is_found():
    clouds = [np.concatenate((one, wall_at(1.0))) for one in passing()]
    clouds[7] = np.zeros((0, 3))
    [(normal, offset)] = find_walls(clouds, np.array([2.0, -3.0, 1.5]))
    assert abs(normal[1]) > 0.999
    assert offset / normal[1] == pytest.approx(1.0, abs=0.01)


def test_what_is_seen_through_is_no_wall():
    """Two posts, and a room between and behind them; beside a wall, a room is as it may be."""
    posts = (wall_at(0.0, -1.5, -1.2, 150), wall_at(0.0, 1.2, 1.5, 150))
    room = np.random.default_rng(5).uniform((-2, 1, 0), (2, 3, 2.5), (1500, 3))
    eye = np.array([0.0, -3.0, 1.5])
    assert find_walls([np.concatenate((*posts, room))] * 3, eye) == []
    beside = np.concatenate((wall_at(0.0), room + np.array([8.0, 0, 0])))
    assert len(find_walls([beside] * 3, eye)) == 1


def test_soles_all_along_a_way_are_no_ground():
    """A ground was seen where nothing but feet went round in a circle."""
    g = np.random.default_rng(6)
    turns = np.linspace(0, 2 * math.pi, 40)
    way = 1.5 * np.stack((np.cos(turns), np.sin(turns), np.zeros(40)), 1)[:, None]
    soles = g.uniform((-0.15, -0.2, 0), (0.15, 0.2, 0.01), (40, 100, 3))
    above_them = g.uniform((-0.1, -0.25, 0.1), (0.1, 0.25, 1.7), (40, 600, 3))
    steps = list(np.concatenate((soles, above_them), 1) + way)
    assert find_ground(steps, UP).ground is None
    floor = g.uniform((-2, -2, 0), (2, 2, 0), (400, 3))
    assert find_ground([np.concatenate((one, floor)) for one in steps], UP).ground is not None
