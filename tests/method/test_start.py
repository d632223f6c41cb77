"""Arguments of `solve`: numpy alone, starts and batches that do not fit."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from observations.joints3d import Joints3D
from priors.pose.prior import PosePrior
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.method.reconstruction import solve
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS
from tests.laws import a_motion

BODY = BodyModel.load()
FPS = 30.0


class Quick:
    """Three iterations of the pose prior."""

    def __init__(self, dtype: torch.dtype = torch.float32) -> None:
        self.prior = PosePrior.load().to(dtype=dtype)

    def stages(self, data: tuple[Term, ...]):
        return tuple(replace(stage, minimiser=LBFGS(3)) for stage in self.prior.stages(data))


def _truth(clips: int = 1, frames: int = 8) -> Motion:
    motion = a_motion(BODY, clips=clips, frames=frames).to(dtype=torch.float32)
    return motion.replace(fps=FPS, start_time=0.0)


def _seen(motion: Motion) -> Joints3D:
    positions = BODY.pose(motion).joints.double().numpy()
    visible = np.ones(positions.shape[:-1], bool)
    visible[:, ::3, 4] = False
    positions[~visible] = np.nan
    return Joints3D(positions, visible, range(22), motion.fps)


def test_plain_numpy_is_fitted():
    result = solve([_seen(_truth())], Quick())
    assert result.failed == (False,)
    assert bool(result.motion.translation.isfinite().all())
    assert result.motion.translation.shape == (1, 8, 3)


def test_double_precision_is_fitted_in_that_of_the_body():
    """Double precision beside the bundled body failed: `expected m1 and m2 to have the same`."""
    seen = _seen(_truth())
    double = Joints3D(seen.positions.double(), seen.visible, seen.joints, FPS)
    single = solve([seen], Quick()).motion
    assert torch.equal(solve([double], Quick()).motion.translation, single.translation)
    body = BODY.to(dtype=torch.float64)
    fitted = solve([seen], Quick(torch.float64), body, start=_truth()).motion
    assert fitted.translation.dtype == torch.float64


def _held(motion: Motion, frames: int) -> Motion:
    return motion.replace(
        translation=motion.translation[:, :1].expand(-1, frames, -1),
        rotations=motion.rotations[:, :1].expand(-1, frames, -1, -1, -1),
        valid=torch.ones(len(motion.valid), frames, dtype=torch.bool),
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda m: m.window(0, 3), "8 frames at 30 per second.*got 3 frames"),
        (lambda m: _held(m, 9), "got 9 frames"),
        (lambda m: m.replace(fps=60.0), "got 8 frames at 60"),
        (lambda m: m.replace(fps=15.0), "got 8 frames at 15"),
        (lambda m: m.replace(start_time=1.0), "from 1 s on"),
        (lambda m: m[0], "one leading axis of clips"),
        (lambda m: m[[0, 0]], "expected a motion of 1 clips, as observed, got 2"),
        (lambda m: m.replace(shape=torch.zeros(1, 300)), "motion of another body"),
        (lambda m: m.replace(translation=m.translation * torch.nan), "start: expected a position"),
        (lambda m: m.replace(rotations=m.rotations * 2), "start: expected a deviation"),
        (lambda m: m.replace(shape=m.shape + 4264), "start: expected a shape coefficient"),
    ],
)
def test_a_start_that_does_not_fit_is_refused(change, said):
    """A start of three frames gave three frames back for eight that were observed."""
    truth = _truth()
    with pytest.raises(ValueError, match=said):
        solve([_seen(truth)], Quick(), start=change(truth))


def test_a_result_of_an_even_number_of_frames_at_60_hz_is_a_start_again():
    """Fits at 30 Hz end a frame earlier, and two people in one film of a phone were refused."""
    truth = _truth().resample(60.0)
    seen = _seen(truth.window(0, 14))
    assert solve([seen], Quick(), start=truth.window(0, 13)).motion.frames == 13
    with pytest.raises(ValueError, match="got 12 frames"):
        solve([seen], Quick(), start=truth.window(0, 12))


def test_a_start_of_another_rate_or_fewer_coefficients_is_taken():
    truth = _truth()
    fitted = solve([_seen(truth)], Quick(), start=truth.resample(15.0)).motion
    assert fitted.frames == 4
    few = truth.replace(shape=truth.shape[:, :4]).to(dtype=torch.float64)
    assert solve([_seen(truth)], Quick(), start=few).motion.shape.shape == (
        1,
        BODY.shape_size,
    )


def test_observations_and_weights_that_do_not_fit_are_refused():
    one, two = _seen(_truth()), _seen(_truth(clips=2))
    with pytest.raises(ValueError, match="at least one observation"):
        solve([], Quick())
    with pytest.raises(ValueError, match="same number of clips in all observations, got 1, 2"):
        solve([one, two], Quick())
    with pytest.raises(ValueError, match="one leading axis of clips"):
        solve([one[0]], Quick())
    for weights in ([1.0, 1.0], [-1.0], [np.nan]):
        with pytest.raises(ValueError, match="weights"):
            solve([one], Quick(), weights=weights)
