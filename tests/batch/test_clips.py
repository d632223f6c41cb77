"""Several clips from Python, and clips of one subject that share one shape."""

import numpy as np
import pytest
import torch

import recon
from recon.batch.clips import shared_shape
from tests.api.test_front_door import Quick, noisy, seen


def test_every_clip_has_a_result_of_its_own():
    clips = [seen(noisy(8)), [seen(noisy(8, 0.05))]]
    results = recon.fit_clips(clips, Quick())
    alone = recon.fit(clips[0], Quick())
    assert len(results) == 2
    assert (results[0].joints - alone.joints).abs().max() < 1e-4
    assert not torch.equal(results[0].motion.shape, results[1].motion.shape)


def test_a_leading_axis_is_one_of_clips():
    both = np.stack((noisy(6), noisy(6, 0.05)))
    results = recon.fit_clips(seen(both), Quick())
    alone = recon.fit(seen(both[1]), Quick())
    assert (results[1].joints - alone.joints).abs().max() < 1e-4


def test_clips_of_one_subject_share_the_median_of_their_shapes():
    clips = [seen(noisy(4, deviation)) for deviation in (0.01, 0.02, 0.04)]
    first = [recon.fit(one, "pose").motion.shape for one in clips]
    results = recon.fit_clips(clips, Quick(), subject=True)
    for result in results:
        torch.testing.assert_close(result.motion.shape, torch.stack(first).median(0).values)
    two = [torch.tensor([0.0, 1.0]), torch.tensor([1.0, 3.0])]
    assert shared_shape(two).tolist() == [0.5, 2.0]


def test_what_are_no_clips_is_refused():
    with pytest.raises(recon.ReconError, match="leading axis of clips"):
        recon.fit_clips(seen(noisy(6)))
    with pytest.raises(recon.ReconError, match="at least one clip"):
        recon.fit_clips([])
    with pytest.raises(recon.ReconError, match="leave one of them out"):
        recon.fit_clips([seen(noisy(6))], subject=True, shape=1.7)
    with pytest.raises(recon.ObservationError, match="clip 1: nothing to fit"):
        recon.fit_clips([seen(noisy(6)), []], Quick())


def test_the_first_look_at_shapes_has_a_method_of_its_own(monkeypatch):
    """The pose prior, which is fitted in one way only, would refuse the clips' method."""
    asked = []

    def fit(clip, prior, **arguments):
        asked.append((prior, arguments.get("method")))
        return recon.fit(clip, Quick())

    monkeypatch.setattr("recon.batch.clips.fit", fit)
    recon.fit_clips([seen(noisy(4))], method="rollout", subject=True)
    assert asked == [("pose", None), ("humor", "rollout")]
