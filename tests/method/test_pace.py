"""Data that are faster than bodies move become means; a fit costs what its seconds cost."""

from typing import Any

import pytest
import torch

import recon
from observations.joints3d import Joints3D
from observations.noise import estimate_noise
from recon.core.skeleton import MIRROR
from recon.method.pace import paced
from recon.simulation.points import Corruption, joints3d
from tests.filmed import bundled, cameras, view, walk

WAY = torch.tensor([1.0, -2.0, 0.5])
"""Velocity of the points, m/s."""


def moving(moments: int, fps: float, **changed: Any) -> Joints3D:
    """Points that all move evenly."""
    times = torch.arange(moments, dtype=torch.float64) / fps
    positions = (times[:, None, None] * WAY).expand(1, -1, 22, -1).clone()
    seen = torch.ones(1, moments, 22, dtype=torch.bool)
    return Joints3D(positions, seen, tuple(range(22)), fps, start_time=3.0).derived(**changed)


@pytest.mark.parametrize(
    ("moments", "fps"), [(301, 300.0), (297, 300.0), (50, 95.0), (400, 999.0)]
)
def test_means_are_of_their_moments_from_the_first_frame_to_the_last(moments, fps):
    seen = moving(moments, fps)
    gone = torch.rand(seen.visible.shape, generator=torch.Generator().manual_seed(0)) < 0.3
    gone[:, :, 3] = torch.arange(moments) > moments // 2  # a point that is lost
    seen = seen.derived(visible=~gone, positions=seen.positions * ~gone[..., None])
    fewer = paced(seen)
    assert 60 <= fewer.fps < 90
    assert fewer.start_time == 3.0
    last = (fewer.moments - 1) / fewer.fps
    assert last == pytest.approx((moments - 1) / fps, abs=1e-9)
    times = torch.arange(fewer.moments, dtype=torch.float64) / fewer.fps
    truth = times[:, None, None] * WAY
    away = (fewer.positions[0] - truth).norm(dim=-1)[fewer.visible[0]]
    assert fewer.visible.double().mean() > 0.75
    assert not fewer.visible[0, -5:, 3].any()
    assert away.median() < 1e-9
    # one frame alone tells no speed
    assert away.max() < 0.6 / fewer.fps * float(WAY.norm())
    assert (fewer.positions[~fewer.visible] == 0).all()


def test_every_frame_counts_once():
    noise = 0.04 * torch.randn(1, 3001, 22, 3, generator=torch.Generator().manual_seed(0))
    for fps, shares in ((300.0, 5), (120.0, 2)):
        seen = moving(3001, fps)
        fewer = paced(seen.derived(positions=seen.positions + noise))
        times = torch.arange(fewer.moments, dtype=torch.float64) / fewer.fps
        left = fewer.positions[0] - times[:, None, None] * WAY
        assert float(left.std()) == pytest.approx(0.04 / shares**0.5, rel=0.06)
        beside = (left[1:] * left[:-1]).mean() / left.square().mean()
        assert abs(float(beside)) < 0.1  # what two means share would count twice
        told = estimate_noise(fewer.positions, fewer.visible)
        assert told == pytest.approx(float(left.std()), rel=0.1)


def test_deviations_and_confidences_are_means():
    std = torch.full((1, 301, 22), 0.01).double()
    std[:, :, 4] = 0.03
    fewer = paced(moving(301, 300.0, std=std, rms_std=0.012))
    assert fewer.std is not None
    torch.testing.assert_close(fewer.std[0, 30], std[0, 30])
    assert fewer.rms_std == 0.012
    motion = walk(20).resample(300.0)
    seen = view(motion, cameras(motion)[0])
    times = torch.arange(seen.moments)[:, None, None] / seen.fps
    evenly = seen.pixels[:, :1] + 200 * times  # pixels per second
    shown = (torch.arange(seen.moments) % 3 > 0)[:, None]
    hidden = seen.derived(
        confidence=0.7 * shown.expand_as(seen.confidence), pixels=evenly * shown[..., None]
    )
    fewer = paced(hidden)
    assert fewer.fps == pytest.approx(60, abs=1)
    assert (fewer.confidence - 0.7).abs().max() < 1e-6
    times = torch.arange(fewer.moments)[:, None, None] / fewer.fps
    assert (fewer.pixels - seen.pixels[:, :1] - 200 * times).abs().max() < 0.01


def test_what_is_slow_sparse_or_moves_stays_as_it_is():
    slow = moving(90, 90.0)
    assert paced(slow) is slow
    fast = moving(301, 300.0)
    few = torch.zeros_like(fast.visible)
    few[:, ::10] = True
    sparse = fast.derived(visible=few)
    assert paced(sparse) is sparse
    motion = walk(10).resample(300.0)
    seen = view(motion, cameras(motion)[0])
    poses = seen.camera.T_camera_world.expand(-1, seen.moments, -1, -1)
    carried = seen.derived(camera=seen.camera.derived(T_camera_world=poses))
    assert paced(carried) is carried


@pytest.mark.numerics
@pytest.mark.parametrize("prior", ["pose", "humor"])
def test_a_fit_of_fast_data_has_their_frames_and_costs_their_seconds(prior):
    """Two seconds at 300 Hz took 20 times as long as at 30 Hz, and hundreds in three views."""
    truth = walk(31)
    found = {}
    for fps in (30.0, 300.0):
        motion = truth.resample(fps)
        seen = joints3d(motion, bundled(), Corruption(noise=0.03), 0).map(lambda t: t[None])
        result = recon.fit(seen, prior)
        assert result.motion.fps == fps
        assert result.motion.frames == motion.frames
        assert result.observed.shape[0] == motion.frames
        assert result.reconstruction.motion.fps <= 90
        away = bundled().pose(result.motion).joints - bundled().pose(motion).joints
        found[fps] = float(away.norm(dim=-1).mean())
    assert found[300.0] < 0.7 * found[30.0]  # more frames are more data


@pytest.mark.numerics
def test_exchanged_sides_are_told_at_any_rate():
    """At 120 Hz names that were exchanged throughout were taken as right: costs fell with rate."""
    motion = walk(31).resample(120.0)
    seen = joints3d(motion, bundled(), Corruption(noise=0.02), 0).map(lambda t: t[None])
    other = seen.replace(
        positions=seen.positions[..., list(MIRROR), :], visible=seen.visible[..., list(MIRROR)]
    )
    assert [one.code for one in recon.fit(other, "pose").repairs] == ["sides exchanged"]
