"""Completes sparse recordings of any length: fits any motion, then refines gait by its cycles.

A fit with a prior of any motion explains the whole recording, by windows, with one shape. Where
few frames were seen, the motion in between is a guess of that prior, and in gait a prior of cycles
knows more. So every cycle that the hips of the first fit show is completed from its data; cycles
that explain them join the data of a second fit of the whole recording. It follows the data where
there are any and cycles in between, and is smooth everywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch

from observations.depth import CLOUD_NOISE
from recon.body.cycles import find_cycles
from recon.body.model import BodyModel
from recon.core.errors import ObservationError, WeightsError
from recon.core.motion import Motion
from recon.fitting.clip import fit_clip
from recon.fitting.cycles import (
    FITTED,
    NAMED_NOISE,
    RATES,
    at_least_30_hz,
    cycle_noise,
    cycle_prior,
    observations_in_space,
    seen_moments_per_second,
    seen_times,
)
from recon.fitting.gait import CompletedCycle, CycleData, joints_of_cycles, stretches_of_cycles
from recon.fitting.methods import FitOptions
from recon.fitting.records import ClipFit, Stretch
from recon.method.sensor import Sensor
from recon.method.stages import Watch

FEW = 12.0
"""Frames with data per second below which cycles of gait help to fill in what happens between."""
_MIN_STRETCH_S = 0.05
"""Duration (s) above which a stretch is reported."""


@dataclass(frozen=True)
class WholeRecording:
    """The two priors that complete a recording: one of any motion, one of gait cycles."""

    completes: ClassVar[bool] = True
    steps: str = "humor"
    """Name of the prior of any motion."""
    cycles: str | None = "anchor"
    """Name of the prior of gait cycles; None for none."""
    weights: str = "open"
    """Weights of the prior of any motion, `open` or a file."""
    cycle_weights: str = "open"
    """Weights of the prior of cycles, `open` or a file."""

    @classmethod
    def load(cls, weights: str, body: BodyModel | None = None) -> "WholeRecording":
        """Return the two default priors, both with the weights of this name.

        Raises:
            WeightsError: when it is not `open`.
        """
        del body
        if weights != "open":
            raise WeightsError(
                "weights: a recording is completed by two priors, each with weights of its own, "
                f"so expected the name open, got {weights}; give a file of weights with --prior "
                "anchor, or give a WholeRecording"
            )
        return cls(weights=weights, cycle_weights=weights)


def complete_recording(
    observations: Sequence[Sensor],
    prior: WholeRecording,
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
    start: Motion | None = None,
) -> ClipFit:
    """Fit one motion to a sparse recording: any motion first, then gait, cycle by cycle.

    Args:
        observations: sensors' data of one clip.
        prior: the priors of any motion and of cycles.
        options: options of the fit; the prior in them is ignored.
        body: body model to be fitted.
        watch: called after every iteration.
        start: an earlier fit, axes (1, time); None for none.

    Raises:
        ObservationError: when at most one frame has data.
    """
    in_space = observations_in_space(observations)
    if in_space and seen_moments_per_second(in_space) == 0 and len(in_space) == len(observations):
        raise ObservationError(
            "at most one frame has data, so there is no motion to fit; give two or more"
        )
    seen = [
        one if one.places is None else at_least_30_hz(one.with_at_most_points(FITTED))
        for one in observations
    ]
    few = bool(in_space) and seen_moments_per_second(in_space) < FEW
    noise = tuple(
        given_or_usual_noise(one, options.noise_of(row), few) for row, one in enumerate(seen)
    )
    any_motion = replace(options, prior=prior.steps, weights=prior.weights, noise=noise)
    begun = start and start.resample(max(one.fps for one in seen))
    first = fit_clip(seen, any_motion, body, watch, begun)
    motion = first.result.clip(0).detach()
    gait = (
        _completed_gait(first, prior, options, body, motion) if few and first.ground_known else []
    )
    stretches = _gait_stretches(gait, observations_in_space(first.observations), motion, prior)
    kept = [one for cycles in gait for one in cycles if one.explains_data]
    if not kept:
        return replace(first, stretches=stretches)
    joints = joints_of_cycles(kept, motion, body)
    begun = motion.map(lambda tensor: tensor[None])
    again = replace(any_motion, noise=(*noise, None))
    second = fit_clip([*seen, joints], again, body, watch, start=begun)
    reports = (*first.result.reports, *second.result.reports)
    return replace(
        second,
        result=replace(second.result, reports=reports),
        noises=second.noises[:-1],
        observations=second.observations[:-1],
        stretches=stretches,
    )


def given_or_usual_noise(sensor: Sensor, given: float | None, few_moments: bool) -> float | None:
    """Return the noise (m) to assume for an observation; None leaves it to be estimated.

    Noise cannot be estimated from few frames, so the usual one is assumed unless it is given.
    Energies are taken at 30 Hz whatever the clock: few frames with data on a fast clock would each
    count for less than a frame, for which a smaller noise compensates.
    """
    if not few_moments or sensor.places is None:
        return given
    usual = NAMED_NOISE if sensor.named else CLOUD_NOISE
    often = max(seen_moments_per_second([sensor]), RATES[0])
    return (usual if given is None else given) * (often / max(sensor.fps, often)) ** 0.5


def _completed_gait(
    first: ClipFit,
    prior: WholeRecording,
    options: FitOptions,
    body: BodyModel,
    motion: Motion,
) -> list[list[CompletedCycle]]:
    """Complete the cycles of every stretch of gait of a first fit from the data."""
    if prior.cycles is None or not (found := find_cycles(motion)):
        return []
    cycles = cycle_prior(prior.cycles, prior.cycle_weights, body)
    seen = observations_in_space(first.observations)
    noises = tuple(cycle_noise(one, options.noise_of(row)) for row, one in enumerate(seen))
    data = CycleData(cycles, seen, noises, body)
    made = [
        [data.completed_cycle(motion, one) for one in stretch]
        for stretch in stretches_of_cycles(found)
    ]
    return [own for rows in made if (own := [one for one in rows if one is not None])]


def _gait_stretches(
    gait: Sequence[Sequence[CompletedCycle]],
    seen: Sequence[Sensor],
    motion: Motion,
    prior: WholeRecording,
) -> tuple[Stretch, ...]:
    """Partition the recording into stretches of gait and the rest."""
    times = torch.cat([seen_times(one) for one in seen]).unique() if seen else torch.zeros(0)

    def moments_between(start: float, stop: float) -> int:
        return int(((times >= start - 1e-6) & (times <= stop + 1e-6)).sum())

    stretches: list[Stretch] = []
    at = motion.start_time
    for cycles in gait:
        start, stop = cycles[0].cycle.start, max(one.cycle.stop for one in cycles)
        if start - at > _MIN_STRETCH_S:
            stretches.append(Stretch(at, start, prior.steps, moments_between(at, start)))
        joined = sum(one.explains_data for one in cycles)
        stretches.append(
            Stretch(
                start,
                stop,
                f"{prior.steps} and {prior.cycles}" if joined else prior.steps,
                moments_between(start, stop),
                len(cycles),
                joined,
                sum(one.energy for one in cycles),
                sum(one.first_energy for one in cycles),
            )
        )
        at = stop
    end = float(motion.times[-1])
    if end - at > _MIN_STRETCH_S or not stretches:
        stretches.append(Stretch(at, end, prior.steps, moments_between(at, end)))
    return tuple(stretches)
