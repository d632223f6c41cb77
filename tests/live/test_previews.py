"""Streams of a network's first looks, and first motions of other streams by it."""

import numpy as np
import pytest
import torch

import recon
from recon.live import beginning
from tests.filmed import cameras, view, walk
from tests.live.conftest import BEGINNING, FPS, FRAMES, codes, joints_of, played, stream
from tests.own_look import Standing

pytestmark = pytest.mark.numerics


@pytest.mark.parametrize("lag", [0, 5])
def test_every_moment_is_told_once_in_its_turn_and_to_be_unrefined(seen, truth, lag):
    found = played(stream(prior="look", lag=lag), seen)
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(FRAMES)])
    assert (joints_of(found) - truth).norm(dim=-1).mean() < 0.05
    assert codes(found) == ["preview"]
    assert all(one.contacts is not None for one in found)
    assert all(bool(one.observed.all()) for one in found)


def test_it_begins_with_the_first_moment(seen):
    assert stream(prior="look", lag=0).push(seen[0]) is not None


def test_hidden_points_dropped_and_late_moments_are_bridged(seen, truth):
    moments = seen.copy()
    moments[10:20, 4:] = np.nan
    order = [k for k in range(FRAMES) if k not in (24, 25)]
    live = stream(prior="look", lag=6)
    found = [one for k in order for one in _pushed(live, moments[k], k)]
    late = _pushed(live, moments[25], 25)
    found += [*late, *live.finish()]
    assert [one.time for one in found] == pytest.approx([k / FPS for k in range(FRAMES)])
    assert (joints_of(found) - truth).norm(dim=-1).mean() < 0.08
    assert not found[12].observed[20]


def _pushed(live: recon.Stream, moment: np.ndarray, k: int):
    estimate = live.push(moment, k / FPS)
    return () if estimate is None else estimate.every


def test_its_window_is_bounded_and_its_shape_is_a_mean(seen):
    live = stream(prior="look", lag=2)
    found = played(live, np.concatenate([seen] * 4), [k / FPS for k in range(4 * FRAMES)])
    changes = torch.stack([one.shape for one in found]).diff(dim=0).abs().amax(-1)
    assert changes[:20].max() > changes[-20:].max()
    live.push(seen[0], 10.0)
    for k in range(1, 100):
        live.push(seen[k % FRAMES], 10.0 + k / FPS)
    tracking = live._tracking
    assert tracking is not None
    assert len(tracking.times) <= 2 + FPS + 1


def test_a_given_shape_and_a_network_of_somebody_else(seen):
    shape = torch.full((16,), 0.5)
    for prior in ("look", Standing()):
        found = played(stream(prior=prior, lag=2, shape=shape), seen[:8])
        assert len(found) == 8
        torch.testing.assert_close(found[-1].shape, shape)


def test_what_it_cannot_see_is_refused_and_calibrated_views_are_seen():
    motion = walk(12)
    views = [view(motion, one) for one in cameras(motion, 3)]
    with pytest.raises(recon.ObservationError, match="points in space"):
        recon.Stream("look", 0).push(views[0].window(0.0, 0.0))
    live, found = recon.Stream("look", 2), []
    for k in range(12):
        estimate = live.push([one.window(k / FPS, k / FPS) for one in views], k / FPS)
        found += [] if estimate is None else estimate.every
    found += live.finish()
    truth = recon.BodyModel.load().pose(motion).joints
    assert (joints_of(found) - truth).norm(dim=-1).mean() < 0.08


@pytest.mark.parametrize("prior", ["pose", "humor"])
def test_other_streams_begin_with_a_look_unless_it_knows_no_such_data(
    seen, truth, monkeypatch, prior
):
    """The first motion was fitted in a third of a second, while ten frames came."""
    fitted = list[int]()
    kept = beginning.fit_clip
    monkeypatch.setattr(beginning, "fit_clip", lambda *given: (fitted.append(1), kept(*given))[1])
    found = played(stream(prior=prior, lag=5), seen)
    assert fitted == []
    assert (joints_of(found)[:BEGINNING] - truth[:BEGINNING]).norm(dim=-1).mean() < 0.03
    played(stream(prior=prior, lag=5), seen + np.float32([0.0, 0.0, 3.0]))
    assert fitted == [1]
