"""Fits gait cycles to sparse scans, landmarks or few frames: the best of fits from many starts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.depth import CLOUD_NOISE
from observations.noise import weights_of
from observations.surfels import fixed_scale_kernel
from recon.body.cycles import LONGEST_CYCLE, SHORTEST_CYCLE
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.errors import ObservationError, ReconError
from recon.core.residuals import Noise
from recon.core.scene import OFFSETS, Scene
from recon.core.struct import concatenate
from recon.fitting.methods import FitOptions, loaded_prior
from recon.fitting.records import ClipFit, seen_moments
from recon.method.cycle_prior import CyclePrior
from recon.method.priors import PriorLike
from recon.method.protocols import REFERENCE_FPS
from recon.method.reconstruction import Reconstruction, data_terms
from recon.method.running import Hypotheses, ranking_objective, run_hypotheses
from recon.method.sensor import Sensor
from recon.method.stages import Stage, Watch
from recon.method.terms import Term, offsets
from recon.method.unknowns import Unknowns

RATES = (30.0, 60.0)
"""Least and largest frame rate (Hz) at which cycles and recordings are completed."""


def completion_rate(fps: float) -> float:
    """Return a frame rate within `RATES` that is a multiple or a divisor of an observation's."""
    if fps < RATES[0]:
        return fps * math.ceil(RATES[0] / fps)
    return fps / math.ceil(fps / RATES[1] - 1e-6)


def at_least_30_hz(sensor: Sensor) -> Sensor:
    """Return the observation with a rate of 30 Hz or more; frames that are added have no data.

    Motions have the clock of their data, and energies are taken at 30 Hz: on a slow clock, a
    motion is too coarse for human movements, and a frame counts for several. A moving sensor keeps
    its clock, as its pose is unknown in between.
    """
    times = math.ceil(RATES[0] / sensor.fps - 1e-6)
    return sensor if times <= 1 else sensor.on_faster_clock(times)


def observations_in_space(observations: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """Return the observations that measure positions in space."""
    return tuple(one for one in observations if one.places is not None)


def seen_moments_per_second(observations: Sequence[Sensor]) -> float:
    """Return the number of frames with data per second, over all sensors."""
    times = seen_moments(observations)
    if len(times) < 2:
        return 0.0
    return (len(times) - 1) / float(times[-1] - times[0])


HEADINGS = 8
"""Number of headings in which typical cycles are tried."""


@dataclass(frozen=True)
class CycleFrames:
    """The frames (mask, rate, start time) at which gait cycles are decoded."""

    valid: Bool[Tensor, "clips time"]
    fps: float
    start_time: float

    @classmethod
    def of(cls, observations: Sequence[Sensor]) -> "CycleFrames":
        """Return frames over all data, at a rate within `RATES` that suits the first observation.

        Raises:
            ObservationError: when a clip shows one moment only, or lasts too short or too long.
        """
        fps, start = completion_rate(observations[0].fps), min(o.start_time for o in observations)
        ends = [first_and_last_times(o) for o in observations]
        first, last = (torch.stack(one) for one in zip(*ends, strict=True))
        if not bool((last.amax(0) > first.amin(0)).all()):
            raise ObservationError(
                "at most one frame has data, so there is no motion to fit; give two or more"
            )
        last = last.amax(0) - start
        worst = last[((last < SHORTEST_CYCLE) | (last > LONGEST_CYCLE)).nonzero()[:1, 0]]
        if len(worst) > 0:
            raise ObservationError(
                f"expected data of one gait cycle, {SHORTEST_CYCLE} to {LONGEST_CYCLE:g} s, got "
                f"{float(worst[0]):.2f} s; cut one cycle out (--between), or fit the whole with "
                "another prior"
            )
        count = (last * fps - 1e-6).ceil().long() + 1
        return cls(torch.arange(int(count.max())) < count[:, None], fps, start)


def first_and_last_times(
    sensor: Sensor,
) -> tuple[Float[Tensor, " clips"], Float[Tensor, " clips"]]:
    """Return the times (s) of each clip's first and last frame with data; infinite if none."""
    there = sensor.shown.any(-1)
    times = sensor.start_time + torch.arange(there.shape[-1], dtype=torch.float64) / sensor.fps
    return times.where(there, torch.inf).amin(-1), times.where(there, -torch.inf).amax(-1)


def typical_cycles(
    prior: CyclePrior[Any],
    observations: Sequence[Sensor],
    frames: CycleFrames,
    shape: Float[Tensor, " shape"],
    offsets: int,
) -> Hypotheses[Any]:
    """Return first hypotheses: every typical cycle under several headings, on the observed path.

    Args:
        prior: prior of gait cycles.
        observations: sensors' data of the clips.
        frames: frames of the cycles.
        shape: shape coefficients of the body.
        offsets: number of tracked points whose offset from the model is unknown.
    """
    typical = prior.typical
    angles = torch.arange(HEADINGS) * (math.tau / HEADINGS)
    turns = so3.about_z(angles.to(typical))
    path = prior.paths(shape)
    variables: list[Any] = []
    for clip, (seen, there) in enumerate(zip(*_centroid_path(observations, frames), strict=True)):
        last = int(frames.valid[clip].sum()) - 1
        place = torch.arange(len(seen)).clamp(max=last) / last * (path.shape[1] - 1)
        walked = path[:, place.round().long()]
        turned = walked[:, None] @ turns.mT
        away = (seen - turned).where(there[:, None], 0.0).sum(-2) / there.sum().clamp(min=1)
        T = torch.eye(4).to(typical).repeat(len(typical), HEADINGS, 1, 1)
        T[..., :3, :3], T[..., :2, 3] = turns, away[..., :2]
        count = T.shape[0] * T.shape[1]
        variables.append(
            prior.variables(
                typical.repeat_interleave(HEADINGS, 0),
                shape.expand(count, -1),
                T.flatten(0, 1),
                frames.valid[clip].expand(count, -1),
                frames.fps,
                frames.start_time,
            )
        )
    clip = torch.arange(len(variables)).repeat_interleave(len(variables[0].latent))
    scene = Scene.create(len(clip), offsets, like=typical)
    return Hypotheses(prior, Unknowns(concatenate(variables), scene), clip)


def _centroid_path(
    observations: Sequence[Sensor], frames: CycleFrames
) -> tuple[Float[Tensor, "clips moments 3"], Bool[Tensor, "clips moments"]]:
    """Return the centroid of the data in the cycle's frames, and a mask of frames with data."""
    clips, moments = frames.valid.shape
    total = observations[0].values.new_zeros(clips, moments, 3)
    count = total.new_zeros(clips, moments, 1)
    for one in observations:
        present = one.shown
        middle = one.values.where(present[..., None], torch.nan).nanmedian(-2).values
        there = present.any(-1)
        times = one.start_time - frames.start_time + torch.arange(there.shape[1]) / one.fps
        frame = (times * frames.fps).round().long().clamp(0, moments - 1)
        total.index_add_(1, frame, middle.nan_to_num(0.0))
        count.index_add_(1, frame, there[..., None].to(count))
    return total / count.clamp(min=1), count[..., 0] > 0


TRIED, KEPT = 16, 3
"""Number of starts per clip that are fitted roughly, and of those that are fitted in full."""
NAMED_NOISE = 0.01
"""Standard deviation (m) of joints and markers, apart from a constant offset."""
MARKER_OFFSET_DEVIATION = 0.01
"""Standard deviation (m) of every coordinate of a marker's offset from the model's place."""
DENSE = 200
"""Number of points in the fullest frame from which on clouds show details that codes lack."""
FITTED = 256
"""Number of points of a frame that are compared: smooth bodies need no more, and time grows with
it."""
ROUGH_RATE = 15.0
"""Approximate frame rate (Hz) while starts are compared: a code moves all frames together."""
_POINTS_PER_CLOUD = 16
"""Number of named points that the cloud of a frame counts as."""
_BATCH_SIZE = 96
"""Number of starts that are evaluated in one batch."""


def complete(
    observations: Sequence[Sensor],
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
) -> ClipFit:
    """Fit one gait cycle to every clip of the batch.

    A clip lasts from its first to its last frame with data; its cycle is assumed to begin and end
    near these.

    Args:
        observations: sensors' data of the clips, which are independent of each other.
        options: options of the fit with a prior of cycles, by name or loaded.
        body: body model to be fitted.
        watch: called after every iteration.

    Raises:
        ValueError: when no data measure positions in space, a clip does not last 0.3 to 3 s, or
            physics, a held shape or further terms are asked for.
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
    seen = observations_in_space(observations)
    if len(seen) < len(observations):
        raise ObservationError(
            "completing a cycle takes scans, landmarks or joints, got 2D keypoints as well; fit "
            "them with another prior"
        )
    prior = cycle_prior(options.prior, options.weights, body)
    seen, rows = _with_marker_offsets(tuple(o.with_at_most_points(FITTED) for o in seen))
    noises = tuple(cycle_noise(o, options.noise_of(row)) for row, o in enumerate(seen))
    dense = any(o.cloud and int(o.cloud.present.sum(-1).max()) >= DENSE for o in seen)
    return _CycleCompletion(seen, noises, prior, dense, CycleFrames.of(seen), rows).fitted_cycles(
        body, watch
    )


def cycle_prior(prior: PriorLike, weights: str, body: BodyModel) -> CyclePrior[Any]:
    """Load a prior of gait cycles.

    Raises:
        ReconError: when it is of something else.
    """
    found = loaded_prior(prior, weights, body)
    if not isinstance(found, CyclePrior):
        raise ReconError(
            f"expected a prior of gait cycles, such as 'anchor', got a {type(found).__name__}"
        )
    return found


@dataclass(frozen=True)
class _CycleCompletion:
    """The data and prior from which one cycle is fitted to every clip, in stages."""

    observations: tuple[Sensor, ...]
    noises: tuple[Noise, ...]
    prior: CyclePrior[Any]
    dense: bool
    """Whether data are dense enough to show details that codes lack."""
    clock: CycleFrames
    offsets: int
    """Number of tracked points whose offset from the model is unknown."""

    def fitted_cycles(self, body: BodyModel, watch: Watch | None) -> ClipFit:
        """Fit cycles from many starts in stages, and return the best fit of every clip."""
        prior, noise = self.prior, self.noise
        # compare first guesses by every `step`-th frame only
        step = max(round(self.clock.fps / ROUGH_RATE), 1)
        seen = [
            _coarse_observation(o, max(round(o.fps / self.clock.fps * step), 1), body)
            for o in self.observations
        ]
        weights = weights_of(self.noises)
        search = prior.search(data_terms(seen, weights), noise)
        ranking, portion = search[0].terms, partial(_with_fewer_frames, step=step)
        search = [replace(stage, portion=portion, ranking=ranking) for stage in search]
        shape = prior.typical.new_zeros(body.shape_size)
        began = typical_cycles(prior, self.observations, self.clock, shape, self.offsets)
        every = torch.arange(len(began.unknowns.variables.latent)).split(_BATCH_SIZE)
        value = torch.cat([ranking_objective(search[0], began.rows(some), body) for some in every])
        data = data_terms(self.observations, weights)
        coded = prior.coded(data, noise)
        details = prior.details(data, noise) if self.dense else ()
        stages = (
            *_stages_keeping(search, KEPT),
            *_stages_keeping(
                [replace(stage, ranking=ranking) for stage in self._with_free_offsets(coded)], 1
            ),
            *self._with_free_offsets(details),
        )
        found, reports = run_hypotheses(stages, body, began.rows(began.best(value, TRIED)), watch)
        T = torch.eye(4).expand(len(self.clock.valid), 4, 4)
        result = Reconstruction(found.estimate(body), tuple(reports))
        return ClipFit(result, self.noises, True, T, self.observations)

    @property
    def noise(self) -> float:
        """Standard deviation of the least noisy observation (m)."""
        return min(one.metres for one in self.noises)

    def _with_free_offsets(self, stages: Sequence[Stage[Any]]) -> list[Stage[Any]]:
        """Return the stages with free offsets of markers wherever the shape is free."""
        if self.offsets == 0:
            return list(stages)
        held = Term("offsets", offsets, (self.noise / MARKER_OFFSET_DEVIATION) ** 2)
        return [
            replace(stage, terms=(*stage.terms, held), free=stage.free | OFFSETS)
            if "shape" in stage.free
            else stage
            for stage in stages
        ]


def _stages_keeping(stages: Sequence[Stage[Any]], count: int) -> tuple[Stage[Any], ...]:
    """Return the stages, the last of which keeps the best `count` hypotheses of every clip."""
    return (*stages[:-1], replace(stages[-1], kept=count))


def _with_fewer_frames(variables: Any, step: int) -> Any:
    """Return the cycle decoded at fewer frames, which suffice to optimise a latent code."""
    return variables.derived(valid=variables.valid[:, ::step], fps=variables.fps / step)


def _coarse_observation(sensor: Sensor, step: int, body: BodyModel) -> Sensor:
    """Take every `step`-th frame; thin clouds, and give them a robust kernel of fixed scale."""
    few = sensor.coarse(body, step)
    return few.derived(kernel=fixed_scale_kernel) if few.cloud else few


def cycle_noise(sensor: Sensor, given: float | None) -> Noise:
    """Return the noise with which a cycle is fitted; a cloud counts as `_POINTS_PER_CLOUD` points.

    The noise is reduced for sparse frames, as energies are sums over all frames of the clock, with
    or without data, taken at 30 Hz.
    """
    count = sensor.shown.sum(-1)
    typical = float(count[count > 0].float().quantile(0.5)) if bool((count > 0).any()) else 1.0
    first, last = first_and_last_times(sensor)
    rate = ((count > 0).sum(-1) - 1) / (last - first)
    seen = rate.isfinite() & (rate > 0)
    often = float(rate[seen].median()) if bool(seen.any()) else sensor.fps
    worth = sensor.fps / max(often, REFERENCE_FPS)
    named = sensor.named is not None
    usual = NAMED_NOISE if named else CLOUD_NOISE
    noise = usual if given is None else given
    cloud_factor = 1.0 if named else max(typical / _POINTS_PER_CLOUD, 1.0)
    return Noise(noise * (cloud_factor / worth) ** 0.5, noise)


def _with_marker_offsets(observations: tuple[Sensor, ...]) -> tuple[tuple[Sensor, ...], int]:
    """Add unknown offsets of markers from the skin; also return their number."""
    changed: list[Sensor] = []
    count = 0
    for one in observations:
        if one.named and one.named.on_skin:
            rows = (count, count + one.shown.shape[-1])
            one, count = one.derived(offset_rows=rows), rows[1]
        changed.append(one)
    return tuple(changed), count
