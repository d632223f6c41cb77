"""Metrics of planted faults, as released and corrected."""

import pytest
import torch

from recon.core.struct import concatenate
from recon.physics import metrics as measuring
from recon.physics.metrics import physics_metrics, physics_samples
from recon.physics.zmp import GRAVITY
from tests import laws
from tests.standing_body import path, standing, times


def table(motion, body, contacts=None):
    return physics_metrics(physics_samples(motion, body, contacts))


def test_who_stands_still_is_right_in_everything(body):
    found = table(standing(body, path(like=times(0.3))), body)
    for name in ("penetrate", "float", "skate", "physdiff_error", "slip_in_contact", "slipping"):
        assert found[name] == pytest.approx(0, abs=1e-9), name
    for name in ("dynamic_stability", "stability_supported"):
        assert found[name] == 1, name
    for name in ("bos_distance", "bos_distance_supported", "stability_flight"):
        assert found[name] is None, name
    assert found["flight"] == 0


def test_penetration_and_float_count_offending_frames_or_all(body):
    heights = torch.tensor([-0.02, -0.004, 0.0, 0.004, 0.03, 0.05], dtype=torch.float64)
    found = table(standing(body, path(z=heights, like=heights)), body)
    assert found["penetrate"] == pytest.approx(0.02)
    assert found["float"] == pytest.approx(0.04)
    assert found["physdiff_penetrate"] == pytest.approx(0.02 / 6)
    assert found["physdiff_float"] == pytest.approx(0.08 / 6)


def test_a_clip_grounded_2_cm_deep_penetrates_no_more(body):
    motion = laws.a_motion(body, clips=1, frames=8, fps=20.0).map(lambda t: t[0])
    low = body.pose(motion).vertices[..., 2].amin()
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    motion = motion.replace(translation=motion.translation - (low + 0.02) * up)
    assert 0 < table(motion, body)["penetrate"] <= 0.02 + 1e-12


@pytest.mark.parametrize("fps", [20.0, 60.0])
def test_sliding_is_measured_in_metres_per_second(body, fps):
    t = times(0.3, fps)
    found = table(standing(body, path(x=0.3 * t, z=-0.002, like=t), fps), body)
    assert found["slip_in_contact"] == pytest.approx(0.3)
    assert found["slipping"] == 1
    assert found["physdiff_skate"] == pytest.approx(0.3 / 20)
    assert found["skate"] == 0  # no joint of this body is under 1.5 cm
    sunk = table(standing(body, path(x=0.3 * t, z=-0.04, like=t), fps), body)
    assert sunk["skate"] == 0.5  # toes are, ankles are not
    still = table(standing(body, path(z=-0.04, like=t), fps), body)
    assert still["skate"] == 0


def test_contacts_of_another_clip_decide_where_slip_counts(body):
    t = times(0.4)
    fast = torch.where(t > 0.2, 0.5 * (t - 0.2), 0.0)
    hovering = standing(body, path(x=fast, z=0.05, like=t))
    assert table(hovering, body)["slip_in_contact"] is None
    late = (t > 0.19)[:, None].expand(-1, 2)
    assert table(hovering, body, late)["slip_in_contact"] == pytest.approx(0.5)
    assert table(hovering, body, ~late)["slip_in_contact"] == pytest.approx(0)


def test_who_is_pushed_is_not_stable(body):
    t = times(0.4)
    found = table(standing(body, path(x=1.5 * t.square() - 0.3 * t, like=t)), body)
    assert found["stability_supported"] == 0
    assert found["bos_distance_supported"] > 0.05  # 3 m/s² at 0.95 m: 29 cm from the centre
    assert found["dynamic_stability"] == 0


def test_a_jump_lowers_the_released_share_and_not_the_supported(body):
    t = times(0.8)
    up = (t - 0.2).clamp(0, 0.4)
    height = GRAVITY / 2 * up * (0.4 - up)
    found = table(standing(body, path(z=height, like=t)), body)
    assert 0.2 < found["flight"] < 0.7
    assert found["stability_supported"] > 0.85  # before landing, soles are near but still fast
    assert found["stability_flight"] == 0
    assert found["dynamic_stability"] == pytest.approx(10 / 17, abs=0.13)


def test_chunks_do_not_show(body, monkeypatch):
    motion = laws.a_motion(body, clips=1, frames=11, fps=20.0).map(lambda t: t[0])
    low = body.pose(motion).vertices[..., 2].amin()
    motion = motion.replace(translation=motion.translation - low * torch.tensor([0, 0, 1.0]))
    contacts = torch.rand(11, 2) > 0.3
    whole = physics_samples(motion, body, contacts)
    monkeypatch.setattr(measuring, "_CHUNK_FRAMES", 4)
    pieces = physics_samples(motion, body, contacts)
    for name, tensor in whole.tensors().items():
        assert torch.allclose(tensor.double(), pieces.tensors()[name].double()), name


def test_clips_are_pooled_by_frame(body):
    one = physics_samples(standing(body, path(z=-0.02, like=times(0.2))), body)
    two = physics_samples(standing(body, path(z=-0.04, like=times(0.7))), body)
    found = physics_metrics(concatenate([one, two]))
    assert found["penetrate"] == pytest.approx((5 * 0.02 + 15 * 0.04) / 20)


def test_padding_is_not_measured(body):
    motion = standing(body, path(z=torch.linspace(0, 0.08, 9).double(), like=times(0.4)))
    padded = motion.replace(valid=torch.arange(9) < 5)
    assert table(padded, body) == table(motion.window(0, 5), body)


def test_bad_clips_are_refused(body):
    motion = standing(body, path(like=times(0.2)))
    with pytest.raises(ValueError, match=r"need 3 frames at 20 frames per second, got 2"):
        physics_samples(motion.window(0, 2), body)
    with pytest.raises(ValueError, match="expected one clip, got a batch"):
        physics_samples(motion.map(lambda t: t[None]), body)
    with pytest.raises(
        ValueError, match="expected contacts of two feet in 5 frames, got an array"
    ):
        physics_samples(motion, body, torch.ones(4, 2, dtype=torch.bool))
