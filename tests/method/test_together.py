"""Fits that share their minimisations: as alone, whatever becomes of a neighbour."""

import threading
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

import recon
from observations.noise import weights_of
from priors.humor.prior import Humor
from priors.pose.prior import PosePrior
from recon.batch import together as threads
from recon.batch.together import Raised, ended_together
from recon.core.struct import stack
from recon.method.alike import alike
from recon.method.reconstruction import solve
from recon.method.terms import Term, prior_energy
from tests.api.test_front_door import noisy, seen
from tests.filmed import bundled, cameras, view, walk


@pytest.fixture
def batches(monkeypatch) -> list[tuple[int, int]]:
    """Problems and frames of every batch."""
    found: list[tuple[int, int]] = []
    joined = threads.solve_joined

    def noted(members):
        results = joined(members)
        # after it: a batch that fails is solved one by one, which only takes longer
        found.append((sum(r is not None for r in results), max(m.lengths[0] for m in members)))
        return results

    monkeypatch.setattr(threads, "solve_joined", noted)
    return found


def ended(functions, frames: int = 1000) -> list:
    found = dict(ended_together(functions, frames))
    return [found[k] for k in range(len(functions))]


def apart(a, b) -> float:
    """Largest distance of two results' joints, metres."""
    assert a.joints.shape == b.joints.shape
    assert a.motion.start_time == b.motion.start_time
    return float((a.joints - b.joints).norm(dim=-1).max())


def several() -> list[recon.Joints3D]:
    """Clips with other lengths, noises, clocks and gaps."""
    clips = [
        seen(noisy(frames, noise), start_time=start)
        for frames, noise, start in ((12, 0.01, 0.0), (13, 0.03, 7.5), (14, 0.06, -100.0))
    ]
    hidden = noisy(13, 0.02)
    hidden[3:, [16, 18, 20]] = np.nan
    return [*clips, seen(hidden)]


@pytest.mark.numerics
def test_clips_of_other_lengths_noises_and_clocks_are_fitted_as_alone(batches):
    """A batch had one noise for all of its clips, which was that of none of them."""
    clips = several()[:2]
    together = ended([partial(recon.fit, one, "pose") for one in clips])
    assert batches[-1] == (2, 13)
    for one, result in zip(clips, together, strict=True):
        alone = recon.fit(one, "pose")
        assert result.noises == alone.noises
        assert apart(result, alone) < 0.004
        assert result.motion.frames == one.moments
        mine, its = (r.reconstruction.reports[-1].solution for r in (result, alone))
        torch.testing.assert_close(mine.value, its.value, rtol=1e-3, atol=0)
        torch.testing.assert_close(result.joint_std, alone.joint_std, rtol=0.05, atol=1e-3)


@pytest.mark.parametrize("prior", [PosePrior, Humor])
def test_a_clip_with_others_is_the_same_to_rounding_before_minimisers_part(prior, batches):
    """Batch-mates may not change what is minimised: a few steps in, rounding is all that shows."""
    clips, few = several(), Few(prior.load())
    together = ended([partial(rough, one, few) for one in clips])
    # where a joint is hidden, HuMoR's method has a stage more, so that clip goes alone
    assert batches == [(4 if prior is PosePrior else 3, 14)]
    for one, result in zip(clips, together, strict=True):
        alone = rough(one, few)
        assert result.noises == alone.noises
        # the largest of all joints, long before the end, where a line search took another turn
        assert apart(result, alone) < 0.02
        reports = zip(result.reconstruction.reports, alone.reconstruction.reports, strict=True)
        for mine, its in list(reports)[:3]:
            assert mine.stage.name == its.stage.name
            begin, same = mine.solution.trace[:, 0], its.solution.trace[:, 0]
            torch.testing.assert_close(begin, same, rtol=1e-3, atol=1e-6)


def rough(clip, prior=None, **arguments) -> recon.Result:
    """A fit of few iterations, before which nothing is checked."""
    return recon.fit(clip, Few() if prior is None else prior, repair=False, **arguments)


class Few:
    """The stages of a prior for the noise of the data, with few iterations."""

    def __init__(self, prior=None) -> None:
        self._prior = PosePrior.load() if prior is None else prior

    def method(self, noise, body):
        return Shortened(self._prior.method(noise, body))


class Shortened:
    def __init__(self, method) -> None:
        self._method = method

    def stages(self, data):
        return tuple(
            replace(stage, minimiser=replace(stage.minimiser, max_iterations=3))
            for stage in self._method.stages(data)
        )


def test_frames_together_are_bounded_and_clips_of_unlike_length_apart(batches):
    clips = [seen(noisy(8)), *(seen(noisy(12, 0.01 * k)) for k in range(1, 6))]
    ended([partial(rough, one) for one in clips], frames=24)
    assert batches == [(2, 12), (2, 12)]
    batches.clear()
    ended([partial(rough, one) for one in clips], frames=1)
    assert batches == []


def test_other_sensors_rates_and_grounds_are_not_joined(batches):
    plain, positions = seen(noisy(12)), noisy(12)
    faster = recon.Joints3D(positions, np.ones((12, 22), bool), range(22), fps=60.0)
    fewer = recon.Joints3D(positions[:, :21], np.ones((12, 21), bool), range(21), fps=30.0)
    clips = [plain, faster, fewer]
    together = ended([partial(rough, one) for one in clips])
    assert batches == []
    for one, result in zip(clips, together, strict=True):
        assert torch.equal(result.joints, rough(one).joints)


def test_clips_at_another_rate_are_joined_where_they_are_of_one_length(batches):
    clips = [
        recon.Joints3D(noisy(frames, 0.01 * k), np.ones((frames, 22), bool), range(22), fps=60.0)
        for k, frames in ((1, 24), (2, 24), (3, 22))
    ]
    together = ended([partial(rough, one) for one in clips])
    assert batches == [(2, 24)]
    for one, result in zip(clips, together, strict=True):
        assert apart(result, rough(one)) < 2e-3


def test_an_unknown_ground_is_each_clips_own(batches):
    clips = [seen(noisy(10) + up, ground_known=False) for up in (0.0, 0.7)]
    together = ended([partial(recon.fit, one, "pose", repair=False) for one in clips])
    assert len(batches) == 2
    for one, result in zip(clips, together, strict=True):
        alone = recon.fit(one, "pose", repair=False)
        assert apart(result, alone) < 0.004
        torch.testing.assert_close(result.ground, alone.ground, atol=0.004, rtol=0)


def filmed(first: int, views: int, seed: int) -> list[recon.Keypoints2D]:
    """What calibrated cameras see of a part of the walk, each part with cameras of its own."""
    motion = walk(10, first).replace(start_time=float(seed))
    places = cameras(motion, views, first=0.3 * seed)
    return [view(motion, camera, 2.0 + seed, seed) for camera in places]


@pytest.mark.parametrize("views", [1, 2])
def test_clips_before_cameras_of_their_own_are_joined(views, batches):
    """Cameras, the sizes of pixels and the offsets of keypoints differ from clip to clip."""
    clips = [filmed(first, views, seed) for first, seed in ((0, 0), (12, 3))]
    together = ended([partial(rough, one) for one in clips])
    assert batches[-1] == (2, 10)
    for one, result in zip(clips, together, strict=True):
        alone = rough(one)
        assert result.noises == alone.noises
        assert apart(result, alone) < 5e-3  # one view hardly tells how far away a person is


def test_clouds_of_as_many_points_are_joined(batches):
    """Correspondences are those of each clip, and weights in front of them its own."""
    clips = [
        recon.simulate(
            walk(6, first).replace(start_time=0.0), "depth", points=80, noise=noise
        ).observations[0]
        for first, noise in ((0, 0.0), (10, 0.03))
    ]
    joints = [seen(noisy(6, noise)) for noise in (0.01, 0.04)]
    both = [list(pair) for pair in zip(joints, clips, strict=True)]
    together = ended([partial(rough, one) for one in both])
    assert batches == [(2, 6)]
    for one, result in zip(both, together, strict=True):
        assert apart(result, rough(one)) < 1e-3


def test_whatever_one_raises_is_its_own():
    def refuse():
        raise recon.ObservationError("no person")

    found = ended([partial(rough, seen(noisy(8))), refuse, lambda: 7])
    assert isinstance(found[0], recon.Result)
    assert isinstance(found[1], Raised)
    assert str(found[1].error) == "no person"
    assert found[2] == 7


class Broken(Few):
    """A prior that fails on the second clip, and on any batch that has it."""

    def method(self, noise, body):
        method = super().method(noise, body)

        class Failing:
            def stages(self, data):
                stages = method.stages(data)
                return tuple(replace(one, terms=(*one.terms, trap)) for one in stages)

        return Failing()


def _spring(estimate):
    if (estimate.motion.translation[..., 0] > 50).any():
        raise RuntimeError("the trap sprang")
    return estimate.motion.translation.sum((-1, -2)) * 0


trap = Term("trap", _spring, 1.0)


def test_a_batch_that_fails_is_solved_one_by_one(caplog):
    far = noisy(8) + 100.0
    clips = [seen(noisy(8)), seen(far), seen(noisy(8, 0.03))]
    with caplog.at_level("INFO", "recon"):
        found = ended([partial(rough, one, Broken()) for one in clips])
    assert "together, RuntimeError('the trap sprang')" in caplog.text
    assert isinstance(found[1], Raised)
    assert str(found[1].error) == "the trap sprang"
    for k in (0, 2):
        assert torch.equal(found[k].joints, rough(clips[k], Broken()).joints)


def test_nan_of_one_clip_is_its_own():
    """Of a batch, all clips would end where the first met nan."""

    def energy(estimate):
        return torch.where(estimate.motion.translation[..., 0] > 50, torch.nan, 0.0).sum(-1)

    far = noisy(8) + 100.0
    clips = [seen(noisy(8)), seen(far)]
    terms = (Term("nan", energy, 1.0),)
    found = ended([partial(rough, one, terms=terms) for one in clips])
    assert [one.failed for one in found] == [False, True]


def test_threads_of_whoever_is_not_heard_end():
    before = threading.active_count()
    running = ended_together([partial(rough, seen(noisy(8))), lambda: 7])
    assert next(running) == (1, 7)
    assert threading.active_count() == before + 1
    running.close()
    assert threading.active_count() == before


def test_what_ends_a_process_ends_it():
    def leave():
        raise SystemExit(3)

    with pytest.raises(SystemExit):
        ended([leave])


def test_no_frames_are_refused():
    with pytest.raises(ValueError, match="at least one frame"):
        list(ended_together([lambda: 1], 0))


def test_the_raw_core_is_shared_as_well(batches):
    """Whoever calls `recon.solve` needs no other code to take part."""
    body, prior = bundled(), PosePrior.load()
    clips = [stack([seen(noisy(6, noise))]) for noise in (0.01, 0.02)]
    found = ended([partial(solve, [one], prior, body) for one in clips])
    assert batches == [(2, 6)]
    for one, result in zip(clips, found, strict=True):
        alone = solve([one], prior, body)
        torch.testing.assert_close(
            result.motion.translation, alone.motion.translation, atol=1e-3, rtol=0
        )


def test_alike_is_what_computes_the_same():
    assert alike(prior_energy("pose"), prior_energy("pose"))
    assert not alike(prior_energy("pose"), prior_energy("step"))
    assert alike(Humor.load(), Humor.load())
    assert alike(bundled(), recon.BodyModel.load())
    assert not alike(torch.zeros(2), torch.ones(2))
    assert not alike(1.0, 1)
    assert alike(partial(weights_of, [1]), partial(weights_of, [1]))
    assert not alike(partial(weights_of, [1]), partial(weights_of, [2]))
    assert not alike(float("nan"), float("nan"))
    one, other = Few(), Few()
    assert alike(one, other)
    other.speed = one
    one.speed = other  # objects that refer to each other end, too
    assert alike(one, other)
    assert alike(np.arange(3), np.arange(3))
    assert not alike(np.arange(3), np.arange(1, 4))
