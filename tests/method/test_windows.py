"""Windows cover a recording; joined again they are the recording, without a seam."""

from itertools import pairwise

import pytest
import torch

from recon.core import rotations as so3
from recon.method.windows import Windows, joined_windows, smooth_ramp
from tests import laws


@pytest.mark.parametrize("total", [121, 122, 137, 240, 301, 333, 1801, 7207])
@pytest.mark.parametrize(
    ("longest", "overlap", "step"),
    [(121, 31, 1), (121, 31, 4), (90, 11, 10), (51, 18, 1), (5, 1, 1)],
)
def test_windows_cover_a_recording_and_meet_their_neighbours_only(total, longest, overlap, step):
    windows = Windows.cover(total, longest, overlap, step)
    starts, frames = windows.starts, windows.frames
    assert starts[0] == 0
    assert starts[-1] + frames == total
    assert frames < longest + step
    assert all(start % step == 0 for start in starts)
    shared = [a + frames - b for a, b in pairwise(starts)]
    assert all(abs(own - overlap) <= 2 * step for own in shared)
    assert all(a + frames <= c for a, c in zip(starts, starts[2:], strict=False))


def test_one_window_is_enough_for_a_short_recording():
    assert Windows.cover(100, 121, 31) == Windows((0,), 100)


@pytest.mark.parametrize("overlap", [0, 48])
def test_windows_that_cannot_be_joined_are_refused(overlap):
    with pytest.raises(ValueError, match="40 %"):
        Windows.cover(1000, 121, overlap)


def cut(motion, *spans):
    return [motion.window(*span) for span in spans]


def test_a_motion_cut_and_joined_is_itself(toy_body):
    motion = laws.a_motion(toy_body, clips=1, frames=50)[0].replace(start_time=3.0)
    whole = joined_windows(cut(motion, (0, 20), (12, 32), (26, 50)))
    assert whole.start_time == 3.0
    assert torch.allclose(whole.translation, motion.translation, atol=1e-12)
    assert torch.allclose(whole.rotations, motion.rotations, atol=1e-7)


def test_windows_of_another_clock_are_brought_onto_the_first_ones(toy_body):
    fine = laws.a_motion(toy_body, clips=1, frames=501, fps=300.0)[0]
    first, second = fine.window(0, 300).resample(30.0), fine.window(203, 501).resample(30.0)
    whole = joined_windows([first, second])
    assert whole.frames == 51  # the last one is at or after the end of the last window
    assert 0 <= whole.stop_time - second.stop_time < 1 / 30
    truth = fine.at(whole.times.clamp(max=fine.stop_time), 30.0)
    assert (whole.translation - truth.translation).norm(dim=-1).max() < 1e-4  # metres
    assert so3.geodesic_angle(whole.rotations, truth.rotations).max() < 2e-3  # radians


def test_different_motions_fade_into_each_other(toy_body):
    still = laws.a_motion(toy_body, clips=1, frames=1)[0]
    still = still.at(still.times.expand(60), 30.0)
    turn = so3.exp(torch.tensor([0.0, 0.0, 0.5], dtype=torch.float64))
    other = still.replace(translation=still.translation + 0.1, rotations=turn @ still.rotations)
    first, second = still.window(0, 40), other.window(20, 60)
    whole = joined_windows([first, second])
    assert torch.allclose(whole.translation[:21], still.translation[:21])
    assert torch.allclose(whole.translation[39:], other.translation[39:])
    assert torch.allclose(whole.rotations[39:], other.rotations[39:], atol=1e-6)
    away = whole.translation[:, 0] - still.translation[:, 0]
    assert away.diff().min() >= 0
    assert away.diff().max() < 1.6 * 0.1 / 19  # the steepest a smooth fade need be
    assert away.diff(n=2).abs().max() < 6.5 * 0.1 / 19**2  # no kink at either end
    turned = so3.geodesic_angle(whole.rotations[:, 0], still.rotations[:, 0])
    assert torch.allclose(turned, 5 * away, atol=1e-6)


def test_what_cannot_be_joined_is_refused(toy_body):
    motion = laws.a_motion(toy_body, clips=1, frames=50)[0]
    with pytest.raises(ValueError, match="no frame in common"):
        joined_windows(cut(motion, (0, 20), (20, 50)))
    with pytest.raises(ValueError, match="one frame rate"):
        joined_windows([motion, motion.resample(60.0)])


def test_a_fade_is_a_partition_and_bounded():
    times = torch.linspace(-1, 3, 41, dtype=torch.float64)
    weight = smooth_ramp(times, 0.0, 2.0)
    assert weight.min() == 0
    assert weight.max() == 1
    assert torch.allclose(weight + smooth_ramp(2 - times, 0.0, 2.0), torch.ones(41).double())
