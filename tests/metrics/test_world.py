"""World-frame metrics against numbers worked out by hand."""

import math

import pytest
import torch

from recon.core import rotations as so3
from recon.metrics.world import (
    foot_sliding,
    jitter,
    root_translation_error,
    w_mpjpe,
    wa_mpjpe,
    world_errors,
)


def cross(frames: int) -> torch.Tensor:
    """Four joints, the corners of a square of 2 m about the origin, that stand still."""
    corners = torch.tensor([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    return corners.double().expand(frames, 4, 3)


def drifting(frames: int, metres: float) -> torch.Tensor:
    """The square, that far from where it was at every later frame."""
    shift = torch.arange(frames, dtype=torch.float64)[:, None, None]
    return cross(frames) + metres * shift * torch.tensor([0.0, 0.0, 1.0]).double()


def test_w_mpjpe_is_the_drift_from_the_first_two_frames():
    """Aligned by two frames at 0 and 0.3 m, their middle 0.15 m goes to the truth: frames k are
    |0.3 k - 0.15| off, and the square tells the rotation and, but for the drift, the scale."""
    predicted, truth = drifting(4, 0.3), cross(4)
    # s = tr(RᵀH) / Σ|x|²: H = Σ y xᵀ has 8 in sum, Σ|x|² = 8 + 8 · 0.15²
    scale = 8 / (8 + 8 * 0.15**2)
    away = [math.hypot(1 - scale, scale * (0.3 * k - 0.15)) for k in range(4)]
    assert w_mpjpe(predicted, truth) == pytest.approx(sum(away) / 4)


def test_wa_mpjpe_spreads_the_drift_over_the_segment():
    predicted, truth = drifting(3, 0.3), cross(3)
    scale = 12 / (12 + 8 * 0.3**2)
    away = [math.hypot(1 - scale, scale * 0.3 * (k - 1)) for k in range(3)]
    assert wa_mpjpe(predicted, truth) == pytest.approx(sum(away) / 3)


def test_segments_of_100_frames_are_aligned_by_themselves():
    truth = cross(200)
    moved = truth.clone()
    moved[100:] = 1.7 * truth[100:] @ so3.about_z(torch.tensor(0.5).double()).mT + 3.0
    assert w_mpjpe(moved, truth) == pytest.approx(0.0, abs=1e-9)
    assert wa_mpjpe(moved, truth) == pytest.approx(0.0, abs=1e-9)
    moved[150:] += 1.0
    assert w_mpjpe(moved, truth) == pytest.approx(math.sqrt(3) / 1.7 / 4)


def test_rte_is_a_share_of_the_path_without_scale():
    """Half as long a path: x of 0, 1, 2 m for 0, 2, 4 m; aligned at 2 m both ends are 1 m off."""
    truth = torch.tensor([[0.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0]]).double()
    turn = so3.about_z(torch.tensor(1.0).double())
    assert root_translation_error(truth / 2 @ turn.mT + 5, truth) == pytest.approx(2 / 3 / 4)
    assert root_translation_error(truth, truth[:1].expand(3, 3)) is None


def test_jitter_is_the_third_difference():
    time = torch.arange(6, dtype=torch.float64) / 10
    path = torch.stack((time**3, 0 * time, 0 * time), -1)[:, None]
    assert jitter(path, 10.0) == pytest.approx(6.0)
    assert jitter(path[:3], 10.0) is None


def test_feet_slide_where_true_feet_stand():
    truth, found = (torch.zeros(3, 22, 3).double() for _ in range(2))
    truth[2, 7, 0] = 0.5  # one ankle steps in the last frame
    found[:, 7, 0] = torch.tensor([0.0, 0.02, 0.5])
    found[:, 10, 1] = torch.tensor([0.0, 0.01, 0.02])
    # steps of standing feet: 0.02 once, 0.01 twice, and zero of the other four
    assert foot_sliding(found, truth, 30.0) == pytest.approx((0.02 + 0.01 + 0.01) / 7)
    assert foot_sliding(found, truth, 60.0) == pytest.approx(2 * (0.02 + 0.01 + 0.01) / 7)


def test_a_clip_of_one_frame_has_no_errors_over_time():
    one = torch.rand(1, 22, 3, dtype=torch.float64)
    found = world_errors(one, one, 30.0)
    assert found["wa_mpjpe"] == pytest.approx(0.0, abs=1e-9)
    assert found["rte"] is found["jitter"] is found["foot_sliding"] is None
