"""Plates under feet: loads go to the foot above them, and plates of another trial are refused."""

import numpy as np
import pytest

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import MotionFile
from recon.mocap.force_plates import ForcePlates
from recon.physics.forces import ground_forces
from recon.physics.plates import forces_under_feet
from tests.standing_body import path, standing, times

FPS, MASS = 50.0, 70.0
AHEAD = np.array([0.01, 0.0, 0.0])


def plates_below(centres: np.ndarray, size: float, start: float = 0.0, frames=51) -> ForcePlates:
    """Square plates about some centres, each loaded with 49 % of the weight in the middle."""
    count = len(centres)
    square = size / 2 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    force = np.zeros((frames, count, 3))
    force[..., 2] = 0.49 * MASS * 9.81
    return ForcePlates(
        force=force,
        centre=np.tile(centres, (frames, 1, 1)),
        torque=np.zeros((frames, count)),
        loaded=np.ones((frames, count), dtype=bool),
        corners=centres[:, None] + square,
        fps=FPS,
        start_time=start,
        decisions=(),
    )


@pytest.fixture(scope="module")
def stand(body: BodyModel):
    motion = standing(body, path(like=times(1.0, FPS)), FPS)
    return motion, ground_forces(MotionFile(motion), body, mass=MASS)


def test_each_plate_belongs_to_the_foot_above_it(stand) -> None:
    motion, found = stand
    feet = found.centre[0].numpy()
    right_first = feet[::-1] + AHEAD
    measured = forces_under_feet(plates_below(right_first, 0.05), found, motion)
    assert measured.known.all()
    assert measured.centre[0] == pytest.approx(feet + AHEAD)
    table = measured.errors_of(found)
    for row in table.values():
        assert row["frames"] == 51
        assert row["centre_cm"] == pytest.approx(1.0)
        assert row["vertical_rms_percent"] == pytest.approx(1.0)
        assert row["impulse_percent"] == pytest.approx(100 / 49)


def test_a_plate_under_both_feet_is_left_out_and_said(stand) -> None:
    motion, found = stand
    between = found.centre[0].numpy().mean(0, keepdims=True)
    measured = forces_under_feet(plates_below(between, 1.0), found, motion)
    assert not measured.known.any()
    assert "both feet stood on one plate" in measured.warnings[0]
    assert measured.errors_of(found) == {}


@pytest.mark.parametrize(
    ("shift", "start", "said"),
    [([1.0, 0, 0], 0.0, "another trial"), ([0.0, 0, 0], 5.0, "from 5.00 to 6.00 s")],
)
def test_plates_of_another_trial_are_refused(stand, shift, start, said) -> None:
    motion, found = stand
    away = found.centre[0].numpy() + np.array(shift)
    with pytest.raises(ReconError, match=said):
        forces_under_feet(plates_below(away, 0.05, start), found, motion)
