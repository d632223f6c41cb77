"""What the table of physics in fitting says of motions whose values are known."""

import pytest
import torch

from benchmarks.physics_fit import COLUMNS, PHYSICS_COLUMNS, compared, pooled, table
from priors.pose.prior import PosePrior
from recon.benchmark.protocols import noisy_joints
from recon.body.model import BodyModel
from tests.benchmarks.test_scores import standing


def test_a_sunk_body_penetrates_by_what_it_is_sunk() -> None:
    body, windows = BodyModel.load(), standing()
    stands = pooled([windows.truth[0]], body)
    low = windows.truth[0]
    low = low.replace(translation=low.translation - torch.tensor([0.0, 0.0, 0.1]))
    sunk = pooled([low, low], body)
    assert stands["penetrate"] is not None
    assert sunk["penetrate"] is not None
    assert sunk["penetrate"] == pytest.approx(0.1, abs=0.01)
    assert stands["penetrate"] < 0.01


def test_every_method_and_the_truth_have_a_row() -> None:
    body, windows = BodyModel.load(), standing()
    seen, joints = noisy_joints(windows.truth, body, 0), body.pose(windows.truth).joints
    errors, physical = compared(windows, seen, joints, PosePrior.load(), 0.04, body)
    assert list(errors) == list(physical)
    assert list(errors) == ["HuMoR", "HuMoR, as many steps", "HuMoR, physics", "truth"]
    assert errors["truth"]["mean"]["joints_all"] == pytest.approx(0.0, abs=1e-6)
    for name, row in errors.items():
        assert set(COLUMNS) <= set(row["mean"])
        assert set(PHYSICS_COLUMNS) <= set(physical[name])
    assert physical["truth"] == pooled([windows.truth[i] for i in range(3)], body)
    assert table("title", physical).row_count == 4
