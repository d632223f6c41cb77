"""Finds the first motion of a stream by a network, or by a fit to the first frames."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from observations.moments import Tracker, append_frames
from observations.noise import weights_of
from priors.pose.prior import PosePrior, PoseWeights
from recon.api.preview import likeliest_motion, loaded_look, with_shape
from recon.body.derivatives import BonePoints
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import Noise
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions
from recon.live.moments import Moment
from recon.live.objective import Objective, Window
from recon.live.smoother import ShapeKnowledge, SmoothedWindow
from recon.method.priors import USUAL_NOISE, Prior
from recon.method.stages import Stage
from recon.method.terms import Term

_STEPS_AFTER_FIT, _STEPS_AFTER_LOOK = 4, 2
"""Gauss-Newton steps after the first motion. After a look, more of them take longer and leave the
errors as they are (seven clips of validation people); one is too few."""
_ITERATIONS = 30
"""Iterations over all poses; the Gauss-Newton steps that follow need a start that is near."""


class _FirstPoses(PosePrior):
    """The pose prior with few iterations per stage, for the first fit of a stream."""

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """Return the pose prior's stages, each with at most `_ITERATIONS` iterations."""
        return tuple(
            replace(stage, minimiser=replace(stage.minimiser, max_iterations=_ITERATIONS))
            for stage in super().stages(data, noise, body, method)
        )


@dataclass(frozen=True)
class KnownShape:
    """The person's shape as known before tracking begins."""

    shape: Float[Tensor, " shape"] | None = None
    """Shape coefficients; None where nothing is known of them."""
    knowledge: ShapeKnowledge | None = None
    """Information about the shape from past frames; None where the shape is held."""


def first_window(
    moments: Sequence[Moment],
    noise: tuple[float | None, ...],
    person: KnownShape,
    body: BodyModel,
    poses: PosePrior,
    prior: Prior[Any] | None,
) -> SmoothedWindow:
    """Return the first window of a stream, whose motion a network proposes or a fit finds.

    Raises:
        ReconError: when no motion can be fitted to the moments.
    """
    seen = list(moments[0].seen)
    for moment in moments[1:]:
        seen = [append_frames(a, b) for a, b in zip(seen, moment.seen, strict=True)]
    seen = [one.derived(start_time=0.0) for one in seen]
    proposed = _proposed_motion(seen, noise, person.shape, body)
    motion, offsets, rows, noises = proposed or _fitted_motion(
        seen, noise, person.shape, body, poses
    )
    trackers: tuple[Tracker, ...] = tuple(
        one.derived(offset_rows=row) for one, row in zip(seen, rows, strict=True)
    )
    metres = min(one.metres for one in noises)
    steps = None if prior is None else prior.live(metres)
    shape, knowledge = motion.shape, person.knowledge
    pose_weights = PoseWeights.for_noise(metres)
    objective = Objective(
        body=body,
        density=poses.density,
        weights=pose_weights if steps is None else steps.poses,
        scales=tuple(weights_of(noises)),
        points=tuple(one.points_on_bones(body, shape, offsets) for one in trackers),
        joints=BonePoints.of_joints(body, shape),
        shape=shape,
        rest=body.rest_joints(shape),
        fps=seen[0].fps,
        offsets=offsets,
        pose_weights=pose_weights,
        steps=steps,
    )
    first = SmoothedWindow(
        Window.of(motion.translation, motion.rotations, poses.density),
        objective,
        trackers,
        ShapeKnowledge.none(shape) if knowledge is None else knowledge,
        learning=person.shape is None or knowledge is not None,
    )
    return first.refined(_STEPS_AFTER_FIT if proposed is None else _STEPS_AFTER_LOOK)


_FirstMotion = tuple[Motion, Tensor, Sequence[Any], tuple[Noise, ...]]
"""A motion, offsets of points from the body, the rows of every sensor in these, the noises."""


def _proposed_motion(
    seen: Sequence[Tracker],
    noise: tuple[float | None, ...],
    shape: Float[Tensor, " shape"] | None,
    body: BodyModel,
) -> _FirstMotion | None:
    """Return a first motion that a network proposes; None for data that it cannot use.

    The network takes a tenth of the time of a fit.
    """
    if any(one.named is None for one in seen):
        return None
    batch: Any = [one[None] for one in seen]
    motion, found = likeliest_motion(loaded_look("look", "open", body), batch, body)
    if found.doubt is not None:
        return None
    if shape is not None:
        motion = with_shape(motion, shape, body)
    noises = (one.noise(motion, body, own) for one, own in zip(batch, noise, strict=True))
    frames = torch.arange(seen[0].moments, dtype=torch.float64) / seen[0].fps
    motion = motion[0].at(frames.clamp(max=motion.stop_time), seen[0].fps)
    return motion, motion.shape.new_zeros(0, 3), [None] * len(batch), tuple(noises)


def _fitted_motion(
    seen: Sequence[Tracker],
    noise: tuple[float | None, ...],
    shape: Float[Tensor, " shape"] | None,
    body: BodyModel,
    poses: PosePrior,
) -> _FirstMotion:
    """Fit a first motion to the first frames of a stream, under the pose prior."""
    first = _FirstPoses(poses.density, poses.effective_weights)
    options = FitOptions(prior=first, noise=noise, shape=shape)
    batch: Any = [one[None] for one in seen]
    with torch.enable_grad():
        fit = fit_clip(batch, options, body)
    rows: Any = [vars(one)["offset_rows"] for one in fit.observations]
    offsets = fit.result.estimate.scene.offsets[0].detach()
    return fit.result.motion[0].detach(), offsets, rows, fit.noises
