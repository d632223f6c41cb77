"""Tempo: motions faster than those that HuMoR learned are read slower."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from observations.joints3d import Joints3D
from priors.humor.collocation import Collocation
from priors.humor.likely import FASTEST, slowing_factor
from priors.humor.prior import Humor
from priors.humor.state import at_tempo, relabelled_at_30_hz, states_of
from recon.body.model import BodyModel
from recon.core.skeleton import LEGS
from recon.method.reconstruction import solve
from recon.method.terms import Term
from tests.priors.test_humor import humor
from tests.priors.test_humor_collocation import demo_clip
from tests.priors.test_pose import swinging

pytestmark = pytest.mark.numerics


def travelling(*speeds: float, hidden: tuple[int, ...] = (), fps: float = 60.0) -> Term:
    """Points that go along x at speeds, m/s; the hidden ones stand."""
    times = torch.arange(61) / fps
    places = torch.zeros(len(speeds), 61, 22, 3)
    places[..., 0] = torch.tensor(speeds)[:, None, None] * times[:, None]
    places[:, :, list(hidden)] = 0.0
    shown = torch.ones(places.shape[:-1], dtype=torch.bool)
    shown[..., list(hidden)] = False
    return Term("data", Joints3D(places, shown, tuple(range(22)), fps), 1.0)


@pytest.mark.parametrize("speed", [0.0, 1.5, FASTEST - 0.01])
def test_who_goes_as_fast_as_people_of_the_corpus_is_read_as_they_are(speed: float) -> None:
    assert slowing_factor([travelling(speed)]) == 1.0


def test_twice_as_fast_is_read_slower_by_the_root_of_two() -> None:
    assert slowing_factor([travelling(2 * FASTEST)]) == pytest.approx(math.sqrt(0.5), abs=1e-4)


def test_points_that_nobody_saw_tell_no_speed() -> None:
    seen = travelling(2 * FASTEST, hidden=tuple(LEGS))
    assert slowing_factor([seen]) == pytest.approx(math.sqrt(0.5), abs=1e-4)
    assert slowing_factor([travelling(2 * FASTEST, hidden=tuple(range(22)))]) == 1.0


def test_the_slowest_clip_of_a_batch_counts_and_the_fastest_sensor() -> None:
    fast, mixed = travelling(8.0, 9.0), travelling(0.0, 9.0)
    assert slowing_factor([fast]) == pytest.approx(math.sqrt(FASTEST / 8), abs=1e-4)
    assert slowing_factor([mixed]) == 1.0
    assert slowing_factor([mixed, fast]) == slowing_factor([fast])


def test_sensors_without_places_in_the_world_tell_no_speed() -> None:
    assert slowing_factor([Term("other", lambda e: e.motion.shape.sum(-1), 1.0)]) == 1.0


def test_a_clip_read_slower_lasts_as_long_as_before() -> None:
    clip = swinging(20, 3)[None]
    slower = at_tempo(clip, 0.7)
    assert slower.stop_time == pytest.approx(clip.stop_time, abs=1e-9)
    assert slower.fps == pytest.approx(clip.fps / 0.7, rel=0.05)
    assert at_tempo(slower, 0.7).frames == slower.frames
    assert at_tempo(slower, 1.0).frames == clip.frames


@pytest.mark.parametrize(("frames", "fps"), [(31, 29.97), (20, 25.0), (80, 100.0), (12, 10.0)])
def test_networks_read_a_clip_to_its_end(frames: int, fps: float) -> None:
    """Clips whose rate does not divide 30 Hz lost their last frames."""
    clip = swinging(frames, 3, fps)[None]
    read = at_tempo(clip, 1.0)
    assert read.fps == 30.0
    assert 0 <= read.stop_time - clip.stop_time + 1e-9 < 1 / 30
    inside = torch.from_numpy(np.arange(read.frames - 1) / 30.0)
    before, truth = read.window(0, read.frames - 1), clip.at(inside, 30.0)
    torch.testing.assert_close(before.rotations, truth.rotations)


def test_networks_see_frames_and_not_the_clock(body: BodyModel) -> None:
    """What they think of a motion read at a rate is what they think of it slowed down to 30 Hz."""
    clip = swinging(9, 3)[None]
    fast = clip.replace(fps=45.0)
    slow, quick = states_of(clip, body), states_of(relabelled_at_30_hz(fast), body)
    torch.testing.assert_close(quick.pack(), slow.pack(), rtol=0, atol=0)
    method = Collocation(humor(body))
    prior = method.stages((travelling(8.0, hidden=tuple(LEGS)),))[-1].prior
    assert isinstance(prior, Collocation)
    slower = replace(prior, tempo=30.0 / 45.0)
    thought = prior.poses.encode(fast), prior.poses.encode(clip)
    here, there = (slower.decode(each).energies for each in thought)
    for name in ("step", "latents"):
        torch.testing.assert_close(here[name], there[name], rtol=1e-6, atol=1e-9)


def test_only_limbs_that_nobody_saw_are_found_at_another_tempo(body: BodyModel) -> None:
    method = Collocation(humor(body))

    def tempos(data: Term) -> set[float]:
        priors = [stage.prior for stage in method.stages((data,))]
        return {prior.tempo for prior in priors if isinstance(prior, Collocation)}

    assert tempos(travelling(9.0)) == {1.0}
    assert tempos(travelling(2.0, hidden=tuple(LEGS))) == {1.0}
    (slower,) = tempos(travelling(9.0, hidden=tuple(LEGS)))
    assert slower == pytest.approx(math.sqrt(FASTEST / 9), abs=1e-4)


def test_what_is_read_slower_is_found_in_its_own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("priors.humor.likely.FASTEST", 0.2)
    body = BodyModel.load()
    truth = demo_clip().window(20, 60).replace(start_time=0.0)
    joints = body.pose(truth).joints
    shown = torch.ones(joints.shape[:-1], dtype=torch.bool)
    shown[..., list(LEGS)] = False
    seen = Joints3D(joints, shown, tuple(range(22)), truth.fps)
    result = solve([seen], Collocation.for_noise(Humor.load(), 0.01), body)
    assert not any(result.failed)
    assert 35 < result.motion.fps < 60  # Hz
    assert result.motion.stop_time == pytest.approx(truth.stop_time, abs=1e-6)
    away = (body.pose(result.motion.resample(truth.fps)).joints - joints)[..., list(LEGS), :]
    assert away.norm(dim=-1).mean() < 0.15  # metres


def test_states_of_a_motion_are_of_its_own_rate(body: BodyModel) -> None:
    """Velocities of first states of recordings at 120 Hz were a quarter of the true ones."""
    clip = swinging(9, 3)[None]
    fast = states_of(clip.replace(fps=120.0), body)
    slow = states_of(clip, body)
    torch.testing.assert_close(fast.joint_velocities, 4 * slow.joint_velocities)
    torch.testing.assert_close(fast.angular_velocity, 4 * slow.angular_velocity)
