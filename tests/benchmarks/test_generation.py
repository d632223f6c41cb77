"""What the benchmark of generated motions measures, on motions whose answer is known."""

import pytest
import torch

from benchmarks.generation import Joints, predicted, sliding
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.core.struct import stack
from tests.benchmarks.test_windows import turning


def test_the_nearest_sample_is_the_prediction() -> None:
    truth = BodyModel.load().pose(turning(60, 30.0)).joints
    places = torch.stack((truth + torch.tensor([0.3, 0.0, 0.4]), truth))
    row = predicted(Joints(places, torch.tensor([False, True])), truth)
    assert row["ade"] == pytest.approx(0, abs=1e-6)
    assert row["fde"] == pytest.approx(0, abs=1e-6)
    assert row["ade_mean"] == pytest.approx(0.25)
    assert row["ade_of_mean"] == pytest.approx(0.25)  # half way to the one that is off
    assert row["apd"] is None  # one alone stays on its feet
    assert row["stays"] == 0.5


def test_who_slides_keeps_the_velocity_of_the_pelvis() -> None:
    """The vertical one is left out: nobody falls for two seconds."""
    recorded = turning(240, 120.0)
    moves = torch.arange(240.0)[:, None] / 120 * torch.tensor([[1.0, 2.0, 3.0]])
    recorded = recorded.replace(translation=recorded.translation + moves)
    truth = stack([recorded.resample(30.0).window(30, 31)])
    windows = TrueWindows(truth, torch.zeros(1, 1, 22).bool(), ("07",), ("07_01@1.00",), 1)
    body = BodyModel.load()
    slid = sliding(recorded, windows, 0, body)
    first = body.pose(truth).joints[0, 0]
    torch.testing.assert_close(slid[0, 0], first)
    expected = torch.tensor([1.0, 2.0, 0.0]).expand(22, 3)
    torch.testing.assert_close(slid[0, 30] - first, expected, atol=1e-4, rtol=0)
