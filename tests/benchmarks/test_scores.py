"""What the tables of HuMoR say of motions whose values are known."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from benchmarks.humor import Entry, evenly, fitted_rows
from benchmarks.humor_recipes import UPPER_BODY, interpolated
from benchmarks.scores import WINDOWS, Fitted, constant_contacts, fit_windows, score, tables
from priors.pose.prior import PosePrior
from recon.benchmark.protocols import noisy_joints
from recon.benchmark.windows import TrueWindows
from recon.body.contacts import rest_heights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import FEET, JOINTS
from recon.core.struct import stack
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS
from tests.benchmarks.test_windows import turning


def standing(count: int = 3, frames: int = 12) -> TrueWindows:
    """Bodies that stand on the ground, turning; their feet are said to touch it half the time."""
    body = BodyModel.load()
    motion = turning(frames, 30.0)
    height = rest_heights(body, motion.shape)[0] - body.rest_joints(motion.shape)[0, 2]
    motion = motion.replace(translation=height * torch.tensor([[0.0, 0, 1]]).expand(frames, 3))
    contacts = torch.zeros(count, frames, 22, dtype=torch.bool)
    contacts[:, : frames // 2, list(FEET)] = True
    return TrueWindows(
        truth=stack([motion] * count),
        contacts=contacts,
        subjects=("a", "a", "b", "c")[:count],
        names=("1", "2", "3", "4")[:count],
        listed=9,
    )


class Hurried:
    """The pose prior with few iterations."""

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        return tuple(replace(stage, minimiser=LBFGS(5)) for stage in PosePrior.load().stages(data))


def test_the_truth_is_without_error_and_stands_on_the_ground() -> None:
    windows, body = standing(), BodyModel.load()
    rows = score(windows, Fitted(windows.truth), body)
    assert set(rows) == {"a", "b", "mean", WINDOWS}
    for row in (rows[name] for name in ("a", "b", "mean")):
        assert row["joints_all"] == pytest.approx(0.0, abs=1e-6)
        assert row["accel_ratio"] == pytest.approx(1.0)
        assert row["sole_height"] == pytest.approx(0.0, abs=1e-4)  # metres
        assert row["seconds"] is None


def test_a_body_in_the_air_is_seen_to_be_there() -> None:
    windows, body = standing(), BodyModel.load()
    lifted = windows.truth.replace(translation=windows.truth.translation + 0.02)
    row = score(windows, Fitted(lifted), body)["mean"]
    assert row["sole_height"] == pytest.approx(0.02, abs=1e-4)
    assert row["sole_height_truth"] == pytest.approx(0.0, abs=1e-4)
    assert row["joints_all"] == pytest.approx(0.02 * 3**0.5, abs=1e-5)
    # labelled from the motion: always in contact, and so right by half
    assert row["feet_balanced"] == 0.5


def test_a_constant_guess_is_worth_one_half() -> None:
    row = constant_contacts(standing())["mean"]
    assert row["feet_balanced"] == pytest.approx(0.5)


def test_frames_and_windows_are_taken_together() -> None:
    windows = standing()
    some = windows.take([0, 2]).frames(2, 8)
    assert some.subjects == ("a", "b")
    assert some.truth.frames == some.contacts.shape[1] == 6
    assert some.truth.start_time == pytest.approx(2 / 30)
    fitted = Fitted(windows.truth[[0, 2]]).frames(2, 8)
    assert score(some, fitted, BodyModel.load())["mean"]["joints_all"] == pytest.approx(
        0, abs=1e-6
    )


def test_few_windows_are_spread_over_the_list() -> None:
    windows = standing()
    assert evenly(windows, None) == evenly(windows, 7) == [0, 1, 2]
    assert evenly(windows, 2) == [0, 2]


def test_methods_that_fit_few_windows_are_compared_on_those() -> None:
    windows, body = standing(frames=6), BodyModel.load()
    truth = body.pose(windows.truth).joints
    observed = noisy_joints(windows.truth, body, 0, 0.01)
    method = Hurried()
    entries = [Entry("all", method), Entry("one", method, most=1)]
    rows = fitted_rows(windows, observed, truth, entries, body)
    assert list(rows) == ["all", "one", "truth"]
    assert set(rows["one"]) == {"a", "mean", WINDOWS}
    assert rows["one"][WINDOWS]["names"] == ("1",)
    error = rows["all"]["mean"]["joints_all"]
    assert error is not None
    assert 0.0 < error < 0.05
    assert rows["all"]["mean"]["observed_all"] == pytest.approx(error)  # they are the joints
    assert rows["truth"]["mean"]["observed_all"] == 0
    means, single = tables("title", {"joints_all": ("all", 100)}, rows)
    assert means.row_count == single.row_count == 3
    again = fit_windows(observed, method, body, at_once=2).motion
    one = fit_windows(observed[:1], method, body).motion
    torch.testing.assert_close(again[:1].translation, one.translation, rtol=0, atol=1e-3)  # m


def test_a_gap_is_bridged_at_an_even_pace() -> None:
    motion = turning(30, 30.0)
    moving = torch.arange(30.0)[:, None] * torch.tensor([[0.1, 0.0, 0.0]])
    motion = motion.replace(translation=moving)[None]
    broken = motion.map(torch.clone)
    broken.rotations[:, 10:20] = torch.eye(3)
    broken.translation[:, 10:20] = 7.0
    bridged = interpolated(broken, 10, 20)
    expected: Motion = motion.window(10, 20)
    torch.testing.assert_close(bridged.translation, expected.translation)
    torch.testing.assert_close(bridged.rotations, expected.rotations, rtol=0, atol=1e-5)
    torch.testing.assert_close(bridged.times, expected.times)


def test_the_upper_body_is_without_legs() -> None:
    names = [JOINTS[joint] for joint in UPPER_BODY]
    assert len(names) == 14
    assert {"pelvis", "head", "left_wrist"} < set(names)
    assert not any(part in name for name in names for part in ("hip", "knee", "ankle", "foot"))
