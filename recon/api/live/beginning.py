"""The first motion of a stream: the ordinary fit of the moments that came so far."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from observations.noise import weights_of
from observations.together.moments import Tracker, joined
from priors.pose.prior import PosePrior
from recon.api.live.moments import Moment
from recon.api.live.objective import LivePrior
from recon.api.live.shape import ShapeKnowledge
from recon.api.live.smoother import Smoothed, begun
from recon.api.live.window import Window
from recon.body.model import BodyModel
from recon.fitting.clip import fit_clip
from recon.fitting.options import FitOptions
from recon.method.priors import Traits
from recon.method.stages import Stage
from recon.method.terms import Term

_ITERATIONS = 30
"""Iterations over all poses; the Gauss-Newton steps that follow need a start that is near."""


@dataclass(frozen=True)
class _FirstPoses:
    """The pose prior, minimised for a short while."""

    traits: ClassVar[Traits] = PosePrior.traits
    poses: PosePrior

    def method(self, noise: float, body: BodyModel) -> "_FirstPoses":
        """A copy of the prior whose weights suit this noise."""
        return _FirstPoses(self.poses.method(noise, body))

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """The root first, then all."""
        return tuple(
            replace(stage, minimiser=replace(stage.minimiser, max_iterations=_ITERATIONS))
            for stage in self.poses.stages(data)
        )


@dataclass(frozen=True)
class Person:
    """What is known of the person before a motion begins."""

    shape: Float[Tensor, " shape"] | None = None
    """Shape coefficients; None is anybody."""
    knowledge: ShapeKnowledge | None = None
    """What frames have told of the shape; None where it is held."""


def begin(
    moments: Sequence[Moment],
    noise: tuple[float | None, ...],
    person: Person,
    body: BodyModel,
    poses: PosePrior,
    prior: LivePrior | None,
) -> Smoothed:
    """A window of these moments, each one frame after the other, fitted under the pose prior.

    Raises:
        ReconError: when nothing can be fitted to them.
    """
    seen = list(moments[0].seen)
    for moment in moments[1:]:
        seen = [joined(a, b) for a, b in zip(seen, moment.seen, strict=True)]
    seen = [one.derived(start_time=0.0) for one in seen]
    options = FitOptions(prior=_FirstPoses(poses), noise=noise, shape=person.shape)
    batch: Any = [one[None] for one in seen]
    with torch.enable_grad():
        fit = fit_clip(batch, options, body)
    motion, scene = fit.result.motion[0].detach(), fit.result.estimate.scene.detach()
    rows: Any = [vars(one)["offset_rows"] for one in fit.observations]
    trackers: list[Tracker] = [
        one.derived(offset_rows=row) for one, row in zip(seen, rows, strict=True)
    ]
    knowledge = person.knowledge
    if person.shape is None and knowledge is None:
        knowledge = ShapeKnowledge.none(motion.shape)
    return begun(
        Window.of(motion.translation, motion.rotations, poses.density),
        motion.shape,
        trackers,
        weights_of(fit.noises),
        min(one.metres for one in fit.noises),
        scene.offsets[0],
        body,
        poses.density,
        knowledge,
        prior,
    )
