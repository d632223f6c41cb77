"""Cycles from sparse scans, landmarks or few frames: many beginnings, the best fit of all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch

from observations.depth import CLOUD_NOISE, PointCloud
from observations.noise import weights_of
from observations.records.surfaces import bounded
from observations.together import kinds
from observations.together.kinds import InSpace
from recon.body.model import BodyModel
from recon.core.errors import ObservationError, ReconError
from recon.core.residuals import Noise
from recon.core.scene import OFFSETS
from recon.fitting.clip import ClipFit
from recon.fitting.cycles.beginnings import CycleClock, seen_from_to, typical_cycles
from recon.fitting.options import FitOptions
from recon.fitting.priors import loaded
from recon.method.priors import CycleMethod, CyclePrior
from recon.method.protocols import REFERENCE_FPS, Sensor
from recon.method.reconstruction import Reconstruction
from recon.method.running import rank, run_hypotheses
from recon.method.stages import Stage, Watch
from recon.method.terms import Term, offsets

TRIED, KEPT = 16, 3
"""Beginnings of a clip that are fitted roughly, and those of them that are fitted in full."""
NAMED_NOISE = 0.01
"""Metres that joints and markers are off by, beside a constant offset."""
MARKER_OFFSET_DEVIATION = 0.01
"""Metres per axis by which markers are not where the model has them."""
DENSE = 200
"""Points in the fullest frame from which on clouds tell what no code has."""
FITTED = 256
"""Points of a frame that are compared: smooth bodies need no more, and time grows with them."""
ROUGH_RATE = 15.0
"""Frames per second, about, while first guesses are compared: a code moves all moments
together."""
_WORTH = 16
"""Points that know their place on the body, as which the cloud of a frame counts."""
_AT_ONCE = 96
"""Beginnings that are looked at together."""


def complete(
    observations: Sequence[Sensor],
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
    kind: Callable[..., CycleMethod] | None = None,
) -> ClipFit:
    """Fit one cycle to every clip of the batch.

    A clip lasts from its first moment to the last that shows anything; its cycle is taken to
    begin and end there, about.

    Args:
        observations: of the clips, which are independent of each other.
        options: of the fit; its prior is of cycles, by name or loaded.
        body: whose motion it is.
        watch: told about every iteration.
        kind: of method, called as kind(prior, noise, detailed=...), instead of the prior's own.

    Raises:
        ValueError: when nothing tells where the body is, a clip does not last 0.3 to 3 s, or
            physics, a shape that is held or further terms are asked for.
    """
    if options.physics != 0:
        raise ObservationError(
            "cycles are completed without physics; leave it out, or fit by another prior"
        )
    if options.shape is not None or options.shape_prior is not None or options.terms:
        raise ObservationError(
            "cycles are completed with a shape of their own and no further terms; leave shape and "
            "terms out, or fit by another prior"
        )
    device = body.template.device
    seen = tuple(o.to(device=device) for o in kinds.in_space(observations))
    if len(seen) < len(observations):
        raise ObservationError(
            "completing a cycle takes scans, landmarks or joints, got 2D keypoints as well; fit "
            "them with another prior"
        )
    prior = loaded(options.prior, options.weights, body)
    if not isinstance(prior, CyclePrior):
        raise ReconError(f"expected a prior of cycles, got a {type(prior).__name__}")
    seen, rows = _with_offsets(tuple(o.thinned(FITTED) for o in seen))
    noises = tuple(cycle_noise(o, options.noise_of(row)) for row, o in enumerate(seen))
    dense = any(_fullest(o) >= DENSE for o in kinds.clouds(seen))
    noise = min(one.metres for one in noises)
    method = (
        prior.cycle_method(noise, detailed=dense)
        if kind is None
        else kind(prior, noise, detailed=dense)
    )
    return _Completion(seen, noises, method, CycleClock.of(seen), rows).fitted(body, watch)


@dataclass(frozen=True)
class _Completion:
    """The stages that lead from typical cycles to the one of every clip."""

    observations: tuple[InSpace, ...]
    noises: tuple[Noise, ...]
    method: CycleMethod
    clock: CycleClock
    offsets: int
    """Tracked points whose offset from the model is unknown."""

    def fitted(self, body: BodyModel, watch: Watch | None) -> ClipFit:
        """The best fit of every clip."""
        prior, step = self.method.prior, self._rough_step
        seen = [
            _rough(o, max(round(o.fps / self.clock.fps * step), 1), body)
            for o in self.observations
        ]
        search = self.method.search(self._data(seen))
        ranking, portion = search[0].terms, partial(_thinned, step=step)
        search = [replace(stage, portion=portion, ranking=ranking) for stage in search]
        shape = prior.typical.new_zeros(body.shape_size)
        began = typical_cycles(prior, self.observations, self.clock, shape, self.offsets)
        every = torch.arange(len(began.unknowns.variables.latent)).split(_AT_ONCE)
        value = torch.cat([rank(search[0], began.rows(some), body) for some in every])
        data = self._data(self.observations)
        coded, details = self.method.coded(data), self.method.details(data)
        stages = (
            *_keeping(search, KEPT),
            *_keeping([replace(stage, ranking=ranking) for stage in self._moving(coded)], 1),
            *self._moving(details),
        )
        found, reports = run_hypotheses(stages, body, began.rows(began.best(value, TRIED)), watch)
        T = torch.eye(4).expand(len(self.clock.valid), 4, 4)
        result = Reconstruction(found.estimate(body), tuple(reports))
        return ClipFit(result, self.noises, True, T, self.observations)

    @property
    def _rough_step(self) -> int:
        """Moments of the clock from one to the next while first guesses are compared."""
        return max(round(self.clock.fps / ROUGH_RATE), 1)

    def _data(self, seen: Sequence[InSpace]) -> tuple[Term, ...]:
        """Observations of the clips as weighted terms."""
        return tuple(
            Term("data" if len(seen) == 1 else f"data {k + 1}", one, weight)
            for k, (one, weight) in enumerate(zip(seen, weights_of(self.noises), strict=True))
        )

    def _moving(self, stages: Sequence[Stage[Any]]) -> list[Stage[Any]]:
        """The stages with offsets of markers, from the one in which they are near the body."""
        if self.offsets == 0:
            return list(stages)
        held = Term("offsets", offsets, (self.method.noise / MARKER_OFFSET_DEVIATION) ** 2)
        return [
            replace(stage, terms=(*stage.terms, held), free=stage.free | OFFSETS)
            if "shape" in stage.free
            else stage
            for stage in stages
        ]


def _keeping(stages: Sequence[Stage[Any]], count: int) -> tuple[Stage[Any], ...]:
    """Stages of which the last keeps so many hypotheses of every clip."""
    return (*stages[:-1], replace(stages[-1], kept=count))


def _thinned(variables: Any, step: int) -> Any:
    """A cycle on a clock of fewer moments: a code moves all moments together."""
    return variables.derived(valid=variables.valid[:, ::step], fps=variables.fps / step)


def _rough(one: InSpace, step: int, body: BodyModel) -> InSpace:
    """Every `step`-th moment, of clouds few points and a kernel of fixed scale."""
    few = one.coarse(body, step)
    return few.derived(kernel=bounded) if kinds.clouds([few]) else few


def _fullest(cloud: PointCloud) -> int:
    return int(cloud.present.sum(-1).max())


def cycle_noise(one: InSpace, told: float | None) -> Noise:
    """A frame's cloud is worth some points that know their place; few frames count one each.

    Energies are sums over all frames of the clock, empty or not, taken at 30 Hz.
    """
    count = one.shown.sum(-1)
    typical = float(count[count > 0].float().quantile(0.5)) if bool((count > 0).any()) else 1.0
    first, last = seen_from_to(one)
    rate = ((count > 0).sum(-1).cpu() - 1) / (last - first)
    seen = rate.isfinite() & (rate > 0)
    often = float(rate[seen].median()) if bool(seen.any()) else one.fps
    worth = one.fps / max(often, REFERENCE_FPS)
    named = bool(kinds.tracked([one]))
    usual = NAMED_NOISE if named else CLOUD_NOISE
    noise = usual if told is None else told
    alike = 1.0 if named else max(typical / _WORTH, 1.0)
    return Noise(noise * (alike / worth) ** 0.5, noise)


def _with_offsets(observations: tuple[InSpace, ...]) -> tuple[tuple[InSpace, ...], int]:
    """Markers stand off the skin: rows of their offsets, and how many."""
    changed: list[InSpace] = []
    count = 0
    for one in observations:
        for markers in kinds.markers([one]):
            rows = (count, count + len(markers.vertices))
            one, count = markers.replace(offset_rows=rows), rows[1]
        changed.append(one)
    return tuple(changed), count
