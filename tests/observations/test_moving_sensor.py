"""Sensors that are said to stand still, or do not know their pose, and move."""

import math
from dataclasses import replace

import numpy as np
import pytest

from recon.core.errors import ObservationError
from recon.formats.observations import CameraArrays, PointsFile
from recon.reading.moving_sensor import sensor_movement

UP = np.array([0.0, -1.0, 0.0])


def scans(degrees: float, rise: float = 0.0, frames: int = 20):
    """A floor 1.2 m below a sensor that is tilted and lifted in the course of the clip."""
    random = np.random.default_rng(0)
    clouds = []
    for k in range(frames):
        share = k / (frames - 1)
        angle = math.radians(degrees) * share
        c, s = math.cos(angle), math.sin(angle)
        floor = random.uniform((-2, 1.2, 1), (2, 1.2, 4), (800, 3))
        floor[:, 1] += rise * share
        floor += random.normal(0, 0.01, floor.shape)
        clouds.append(floor @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T)
    camera = CameraArrays(np.array([[365.0, 0, 256], [0, 365.0, 212], [0, 0, 1]]), (512, 424))
    numbers = np.repeat(np.arange(frames), 800)
    return PointsFile(np.concatenate(clouds), numbers, fps=30.0, camera=camera)


def moves(file: PointsFile) -> tuple[str, ...]:
    clouds = [file.points[file.frame == k] for k in range(int(file.frame.max()) + 1)]
    return sensor_movement(file.camera, clouds, UP)


def test_a_sensor_that_stands_still_is_not_said_to_move():
    assert moves(scans(0.0)) == ()


@pytest.mark.parametrize(("degrees", "rise"), [(12.0, 0.0), (0.0, 0.4)])
def test_a_sensor_that_moves_is_refused(degrees, rise):
    """A body 7 m tall was fitted to what a tilting sensor saw."""
    with pytest.raises(ObservationError, match="so the sensor moves"):
        moves(scans(degrees, rise))


def test_a_sensor_that_trembles_is_said():
    (note,) = moves(scans(3.0))
    assert "seems to move" in note


def room(degrees: float, frames: int = 20) -> PointsFile:
    """A floor and a wall 4 m before a sensor that turns about the vertical."""
    random = np.random.default_rng(1)
    clouds = []
    for k in range(frames):
        angle = math.radians(degrees) * k / (frames - 1)
        c, s = math.cos(angle), math.sin(angle)
        floor = random.uniform((-2, 1.2, 1), (2, 1.2, 4), (500, 3))
        wall = random.uniform((-2, -1.2, 4), (2, 1.2, 4), (500, 3))
        both = np.concatenate((floor, wall)) + random.normal(0, 0.01, (1000, 3))
        clouds.append(both @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T)
    numbers = np.repeat(np.arange(frames), 1000)
    return replace(scans(0.0), points=np.concatenate(clouds), frame=numbers)


def test_a_sensor_that_pans_is_refused_where_it_sees_a_wall():
    """Only the ground was compared, which lies in the same plane while a sensor pans."""
    assert moves(room(0.0)) == ()
    with pytest.raises(ObservationError, match="so the sensor moves"):
        moves(room(20.0))
