"""Motions: windows, other rates, batches of unequal clips, and records in general."""

import pytest
import torch

from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion, padded_batch
from recon.core.struct import stack


def wave(frames=31, fps=30.0) -> Motion:
    t = torch.arange(frames, dtype=torch.float64) / fps
    steps = torch.zeros(frames, 22, 3, dtype=torch.float64)
    steps[:, 4, 0] = t
    return Motion.create(
        torch.stack((t, 2 * t, 0 * t), -1), so3.exp(steps), torch.zeros(4).double(), fps, 5.0
    )


def test_motion_linear_in_time_is_exact_at_any_moment():
    moments = torch.tensor([5.0, 5.01, 5.5, 6.0], dtype=torch.float64)
    there = wave().at(moments, 30.0)
    assert torch.allclose(there.translation[:, 0], moments - 5, atol=1e-12)
    assert torch.allclose(so3.log(there.rotations[:, 4])[:, 0], moments - 5, atol=1e-9)


@pytest.mark.parametrize("fps", [20.0, 60.0, 59.0, 120.0])
def test_resampling_keeps_the_clock(fps):
    there = wave().resample(fps)
    assert there.start_time == 5.0
    assert 6 - 1 / fps < there.times[-1] + 1e-9 <= 6 + 1e-6
    assert torch.allclose(there.translation[:, 0], there.times - 5, atol=1e-9)


def test_a_motion_resampled_past_its_end_keeps_its_velocities():
    there = wave().resample(20.0, duration=1.1)
    assert there.stop_time == pytest.approx(6.1)
    assert torch.allclose(there.translation[:, 0], there.times - 5, atol=1e-9)
    assert torch.allclose(so3.log(there.rotations[:, 4])[:, 0], there.times - 5, atol=1e-9)


@pytest.mark.parametrize("fps", [30.0, 29.97, 100.0, 300.0, 1000.0])
def test_resampling_on_a_clock_of_unix_time_loses_no_frame(fps):
    """Such times are exact to 0.2 µs, which is more than a millionth of a frame."""
    for frames in (24, 33, 60, 119):
        there = wave(frames).replace(fps=fps, start_time=1.7e9 + 0.37).resample(2 * fps)
        assert there.frames == 2 * frames - 1


def test_a_motion_resampled_to_a_time_before_its_end_is_cut():
    there = wave().resample(30.0, duration=0.5)
    assert there.frames == 16
    assert torch.equal(there.translation, wave().translation[:16])


def test_moments_outside_are_refused():
    with pytest.raises(ValueError, match="lasts from 5"):
        wave().at(torch.tensor([4.9], dtype=torch.float64), 30.0)


def test_a_window_is_the_motion_at_its_own_times():
    part = wave().window(10, 20)
    assert part.frames == 10
    assert torch.allclose(part.translation, wave().at(part.times, 30.0).translation, atol=1e-9)


@pytest.mark.parametrize(("start", "stop"), [(-2, 4), (1, -1), (4, 2), (99, 109), (4, 99)])
def test_windows_outside_are_refused(start, stop):
    """A negative start gave the right frames at wrong times, a late stop fewer than asked."""
    with pytest.raises(ReconError, match=f"got {start} to {stop}"):
        wave().window(start, stop)


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf"), 1e9])
def test_rates_that_are_none_are_refused(fps):
    with pytest.raises(ReconError, match="fps"):
        wave().resample(fps)


def test_unequal_clips_become_one_batch_that_knows_what_exists():
    batch = padded_batch([wave(31), wave(11)])
    assert batch.translation.shape == (2, 31, 3)
    assert batch.valid.sum(-1).tolist() == [31, 11]
    assert torch.equal(batch[1].window(0, 11).translation, wave(11).translation)
    with pytest.raises(ValueError, match="one frame rate"):
        padded_batch([wave(), wave(fps=20.0)])


def test_a_moment_beside_a_padded_frame_does_not_exist():
    batch = padded_batch([wave(31), wave(11)])
    there = batch.at(torch.tensor([5.0 + 10 / 30, 5.0 + 10.5 / 30]).double(), 30.0)
    assert there.valid.tolist() == [[True, True], [True, False]]


def test_records_move_together():
    batch = stack([wave(), wave()])
    assert set(batch.tensors()) == {"translation", "rotations", "shape", "valid"}
    single = batch.to(dtype=torch.float32)
    assert single.translation.dtype == torch.float32
    assert single.valid.dtype == torch.bool
    assert batch[0].rotations.shape == wave().rotations.shape


def test_shapes_are_checked():
    with pytest.raises(Exception, match="Type-check"):
        Motion.create(torch.zeros(5, 3), torch.zeros(4, 22, 3, 3), torch.zeros(4), 30.0)
