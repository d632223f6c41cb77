"""Evaluation: zero at the truth, planted errors recovered, null where nothing is known."""

import math

import pytest
import torch
from torch import Tensor

from recon.body.contacts import rest_heights
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.metrics.evaluation import ObservedPoints, evaluate, nearest_labels

CONTRACT = {
    "joints_all",
    "joints_legs",
    "joints_visible",
    "joints_hidden",
    "root_joints_all",
    "root_joints_visible",
    "root_joints_hidden",
    "pa_joints",
    "observed_all",
    "observed_visible",
    "observed_hidden",
    "vertices",
    "accel",
    "accel_truth",
    "accel_error",
    "contact_accuracy",
    "contact_balanced",
    "penetration_freq",
    "penetration_dist",
    "penetration_freq_truth",
    "slip_speed",
    "slip_speed_truth",
}


def standing(body: BodyModel, frames: int, fps: float, start_time: float = 0.0) -> Motion:
    """The average body upright on z = 0, swaying its spine and arms, its feet at rest."""
    shape = torch.zeros(body.shape_size, dtype=torch.float64)
    time = start_time + torch.arange(frames, dtype=torch.float64) / fps
    upright = so3.exp(torch.tensor([math.pi / 2, 0.0, 0.0], dtype=torch.float64))
    angles = torch.zeros(frames, 22, 3, dtype=torch.float64)
    angles[:, [3, 16, 18], 0] = 0.3 * (2 * time).sin()[:, None]
    rotations = so3.exp(angles)
    rotations[:, 0] = upright
    pelvis = body.rest_joints(shape)[0]
    place = -pelvis
    place[2] += rest_heights(body, shape)[0]
    return Motion.create(place.expand(frames, 3), rotations, shape, fps, start_time)


@pytest.fixture(scope="module")
def truth(body: BodyModel) -> Motion:
    return standing(body, 61, 120.0, start_time=2.0)


def shifted(motion: Motion, x: float, y: float, z: float) -> Motion:
    shift = torch.tensor([x, y, z], dtype=torch.float64)
    return motion.replace(translation=motion.translation + shift)


def test_truth_against_itself_is_perfect(body: BodyModel, truth: Motion) -> None:
    table = evaluate(truth, truth, body, contacts=_foot_contacts(truth.frames))
    assert set(table) >= CONTRACT
    for name in ("joints_all", "joints_legs", "root_joints_all", "vertices", "accel_error"):
        assert table[name] == pytest.approx(0.0, abs=1e-12)
    assert table["pa_joints"] == pytest.approx(0.0, abs=1e-9)  # metres
    assert table["accel"] == pytest.approx(table["accel_truth"])
    assert table["contact_accuracy"] == table["contact_balanced"] == 1.0
    assert table["slip_speed"] == table["slip_speed_truth"] == pytest.approx(0.0, abs=1e-9)
    assert table["penetration_dist"] == pytest.approx(0.0, abs=1e-9)
    assert table["sole_penetration_dist"] == pytest.approx(0.0, abs=1e-9)


def _foot_contacts(frames: int) -> Tensor:
    contacts = torch.zeros(frames, 22, dtype=torch.float64)
    contacts[:, [7, 8, 10, 11]] = 0.9
    return contacts


def test_what_is_not_given_is_null(body: BodyModel, truth: Motion) -> None:
    table = evaluate(truth, truth, body)
    unknown = {name for name, value in table.items() if value is None}
    assert unknown == {
        "joints_visible",
        "joints_hidden",
        "root_joints_visible",
        "root_joints_hidden",
        "observed_all",
        "observed_visible",
        "observed_hidden",
        "contact_accuracy",
        "contact_balanced",
        "rte",  # the truth stands
    }
    brief = evaluate(truth.window(0, 2), truth, body)
    assert brief["accel"] is brief["accel_truth"] is brief["accel_error"] is None
    assert evaluate(truth.window(0, 1), truth, body)["slip_speed"] is None


def test_a_planted_shift_is_found(body: BodyModel, truth: Motion) -> None:
    table = evaluate(shifted(truth, 0.03, 0.0, -0.04), truth, body)
    for name in ("joints_all", "joints_legs", "vertices"):
        assert table[name] == pytest.approx(0.05)  # metres
    assert table["root_joints_all"] == pytest.approx(0.0, abs=1e-12)
    assert table["pa_joints"] == pytest.approx(0.0, abs=1e-9)
    assert table["penetration_dist"] == pytest.approx(0.04)
    assert table["sole_penetration_dist"] == pytest.approx(0.04)
    assert table["penetration_freq"] == pytest.approx(2 / 6)  # deeper than 0 and 3 cm
    assert table["slip_speed"] == pytest.approx(0.0, abs=1e-9)


def test_a_sliding_estimate_slips(body: BodyModel, truth: Motion) -> None:
    drift = (truth.times - 2.0)[:, None] * torch.tensor([0.0, 0.1, 0.0], dtype=torch.float64)
    table = evaluate(truth.replace(translation=truth.translation + drift), truth, body)
    assert table["slip_speed"] == pytest.approx(0.1)  # m/s
    assert table["slip_speed_truth"] == pytest.approx(0.0, abs=1e-9)


def test_truth_is_read_at_the_estimates_times(body: BodyModel, truth: Motion) -> None:
    slower = standing(body, 11, 30.0, start_time=2.1)
    table = evaluate(slower, truth, body)
    assert table["joints_all"] == pytest.approx(0.0, abs=1e-9)  # metres: the grids coincide
    between = evaluate(standing(body, 11, 29.0, start_time=2.1), truth, body)
    assert between["joints_all"] is not None
    assert between["joints_all"] < 1e-4  # metres: interpolated within 8 ms


def test_a_truth_of_fewer_frames_has_no_accelerations(body: BodyModel, truth: Motion) -> None:
    """A perfect estimate had an error of its acceleration as large as the acceleration itself."""
    coarse = standing(body, 21, 30.0, start_time=2.0)
    table = evaluate(truth, coarse, body)
    assert table["joints_all"] == pytest.approx(0.0, abs=1e-4)
    assert table["accel_error"] is table["accel_truth"] is table["jitter_truth"] is None
    assert table["accel"] is not None
    assert table["accel"] > 0


def test_times_outside_the_truth_are_refused(body: BodyModel, truth: Motion) -> None:
    for start in (1.9, 2.45):
        with pytest.raises(ValueError, match="the truth does not cover the estimate"):
            evaluate(standing(body, 11, 30.0, start_time=start), truth, body)


def test_batches_and_empty_clips_are_refused(body: BodyModel, truth: Motion) -> None:
    batch = truth.map(lambda tensor: tensor[None])
    with pytest.raises(ValueError, match="one by one"):
        evaluate(batch, truth, body)
    nothing = truth.replace(valid=torch.zeros(truth.frames, dtype=torch.bool))
    with pytest.raises(ValueError, match="no valid frame"):
        evaluate(nothing, truth, body)
    with pytest.raises(ValueError, match="no valid frame"):
        evaluate(truth, nothing, body)


def test_padding_is_not_measured(body: BodyModel, truth: Motion) -> None:
    valid = torch.arange(truth.frames) < 40
    spoilt = truth.translation + 100.0 * ~valid[:, None]
    table = evaluate(
        truth.replace(translation=spoilt, valid=valid),
        truth,
        body,
        contacts=_foot_contacts(truth.frames),
    )
    expected = evaluate(
        truth.window(0, 40), truth.window(0, 40), body, contacts=_foot_contacts(40)
    )
    assert table.keys() == expected.keys()
    for name, value in expected.items():
        assert table[name] == (None if value is None else pytest.approx(value, abs=1e-9))


def test_visible_and_hidden_joints_are_told_apart(body: BodyModel, truth: Motion) -> None:
    visible = torch.ones(truth.frames, 22, dtype=torch.bool)
    visible[:, 20] = False
    bent = truth.rotations.clone()
    bent[:, 18] = bent[:, 18] @ so3.exp(torch.tensor([0.0, 0.2, 0.0], dtype=torch.float64))
    estimate = truth.replace(rotations=bent)
    table = evaluate(estimate, truth, body, truth_visible=visible)
    assert table["joints_visible"] == pytest.approx(0.0, abs=1e-12)
    assert table["joints_hidden"] is not None
    assert table["joints_hidden"] > 0.01  # metres
    assert table["joints_all"] == pytest.approx(table["joints_hidden"] / 22)
    assert table["root_joints_hidden"] == pytest.approx(table["joints_hidden"])


def test_observed_points_are_measured_apart(body: BodyModel, truth: Motion) -> None:
    places = torch.zeros(5, 4, 3, dtype=torch.float64)
    visible = torch.tensor([True, True, False, False]).expand(5, 4)
    predicted = places + torch.tensor([0.01, 0.01, 0.03, 0.03], dtype=torch.float64)[:, None]
    table = evaluate(
        truth, truth, body, observed=ObservedPoints(predicted[..., :3], places, visible)
    )
    assert table["observed_visible"] == pytest.approx(0.01 * 3**0.5)
    assert table["observed_hidden"] == pytest.approx(0.03 * 3**0.5)
    assert table["observed_all"] == pytest.approx(0.02 * 3**0.5)


def test_single_precision_is_measured_in_double(body: BodyModel, truth: Motion) -> None:
    table = evaluate(truth.to(dtype=torch.float32), truth, body.to(dtype=torch.float32))
    assert table["joints_all"] == pytest.approx(0.0, abs=1e-6)  # metres


def test_nearest_labels_follow_the_clock() -> None:
    labels = torch.arange(4)[:, None].expand(4, 22) % 2 == 1
    recorded = torch.arange(4, dtype=torch.float64) / 10
    times = torch.tensor([-1.0, 0.04, 0.06, 0.149, 0.31, 9.0], dtype=torch.float64)
    found = nearest_labels(labels, recorded, times)[:, 0]
    assert found.tolist() == [False, False, True, True, True, True]
    alone = nearest_labels(labels[1:2], recorded[1:2], times)
    assert alone.all()
