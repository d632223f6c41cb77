"""Whole recordings from few moments."""

import pytest
import torch

import recon
from observations.depth import PointCloud
from observations.markers3d import Markers3D
from observations.surfels import Surfels
from recon.body.landmarks import LANDMARKS_16, landmark
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.fitting.cycles import NAMED_NOISE, at_least_30_hz, seen_moments_per_second
from recon.fitting.recording import WholeRecording, given_or_usual_noise
from recon.simulation.points import Corruption, landmarks3d
from tests.walk_prior import one_cycle, walk

BODY = BodyModel.load()
RATE = 6.0
"""Moments a second."""


def seen(motion: Motion, fps: float = RATE) -> Markers3D:
    """Sixteen landmarks, few times a second."""
    every = landmarks3d(motion.resample(fps), BODY, Corruption(), 0)
    vertices = tuple(landmark(name) for name in LANDMARKS_16)
    return Markers3D(every.positions[None], every.visible[None], vertices, fps)


def error(found: Motion, truth: Motion) -> float:
    """Mean distance of joints, metres."""
    times = found.times.clamp(max=float(truth.times[-1]))
    pair = [BODY.pose(one.at(times, 30.0)).joints for one in (found, truth)]
    return float((pair[0] - pair[1]).norm(dim=-1).mean())


@pytest.fixture(scope="module")
def truth() -> Motion:
    """A cycle of the bundled walk, and half a second around it."""
    motion, cycle = walk()
    count = int((cycle.duration + 1.0) * 60)
    times = cycle.start - 0.5 + torch.arange(count + 1, dtype=torch.float64) / 60
    return motion.at(times, 60.0).replace(start_time=0.0)


@pytest.mark.numerics
def test_a_walk_of_few_moments_is_completed_under_another_prior(truth):
    result = recon.complete(seen(truth), WholeRecording(prior="pose"))
    assert result.motion.fps >= 30
    assert result.cycle is None
    assert error(result.motion, truth) < 0.035  # metres


@pytest.mark.numerics
def test_few_moments_of_somebody_who_goes_far_are_followed():
    """HuMoR began from one place for all moments, and stayed there: 1.5 m beside a fighter."""
    clip = walk()[0].replace(start_time=0.0)
    there = clip.translation.clone()
    there[:, 0] += torch.linspace(0, 8, clip.frames)  # metres
    far = clip.replace(translation=there)
    found = recon.complete(seen(far, 2.5)).motion
    assert error(found, far) < 0.06  # metres; 0.14 from one place


@pytest.mark.numerics
def test_one_cycle_at_few_moments_is_a_motion_like_others():
    """Codes of cycles alone, from many starts, were up to 14 cm off in one walk of two."""
    cycle = one_cycle(60.0)
    result = recon.complete(seen(cycle))
    assert error(result.motion, cycle) < 0.025  # metres


def test_one_moment_is_refused(truth):
    with pytest.raises(ValueError, match="at most one frame has data"):
        recon.complete(seen(truth.window(0, 1)))


def test_a_slow_clock_becomes_fast_and_shows_the_same(truth):
    """At 5 Hz a motion of poses could not move as people do, and every scan counted for six."""
    markers = at_least_30_hz(seen(truth, 5.0))
    assert markers.fps == 30
    assert seen_moments_per_second([markers]) == pytest.approx(5.0)
    vertices = BODY.pose(truth.resample(5.0)).vertices[:, ::40]
    present = torch.ones(vertices.shape[:2], dtype=torch.bool)
    cloud = PointCloud(vertices[None], present[None], Surfels.of(BODY, 500), 5.0)
    fast = at_least_30_hz(cloud)
    assert isinstance(fast, PointCloud)
    assert fast.fps == 30
    assert torch.equal(fast.points[:, ::6], cloud.points)
    assert int(fast.present.any(-1).sum()) == vertices.shape[0]
    assert at_least_30_hz(seen(truth, 30.0)).fps == 30


def test_scans_at_odd_times_count_as_much_on_a_fast_clock(truth):
    """On the clock of 200 Hz that scans at odd times need, each counted 0.15 of a moment."""
    slow, fast = at_least_30_hz(seen(truth, 5.0)), seen(truth, 200.0)
    shown = torch.zeros_like(fast.visible)
    shown[:, ::40] = fast.visible[:, ::40]
    odd = Markers3D(fast.positions, shown, fast.vertices, 200.0)
    noises = [given_or_usual_noise(one, None, few_moments=True) for one in (slow, odd)]
    assert noises[0] == pytest.approx(NAMED_NOISE)
    assert noises[1] == pytest.approx(NAMED_NOISE * 0.15**0.5)
    assert given_or_usual_noise(odd, 0.02, few_moments=True) == pytest.approx(0.02 * 0.15**0.5)
    assert given_or_usual_noise(fast, None, few_moments=False) is None
