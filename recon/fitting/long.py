"""Fits recordings of any length by overlapping windows with one shape and matching overlaps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.struct import concatenate, stack
from recon.fitting.long_recording import AT_ONCE, LongRecording
from recon.fitting.stages import until_first_shape_stage, with_shape_held
from recon.method.priors import PriorLike, stages_of
from recon.method.protocols import Decoded, Estimate
from recon.method.reconstruction import Reconstruction, checked_arguments, reconstruct
from recon.method.sensor import Sensor
from recon.method.stages import Stage, StageReport, Stages, Watch
from recon.method.terms import Term
from recon.method.windows import joined_windows
from recon.solver.lbfgs import Solution

WINDOW, OVERLAP = 6.0, 1.0
"""Longest duration (s) of a window, and the time (s) that it shares with each neighbour."""
TIE = 1.0
"""Weight of a joint of a finished neighbouring window relative to one of the first observation."""


@dataclass(frozen=True)
class LongReconstruction(Reconstruction):
    """The reconstruction of a long clip, joined from its windows, and their reports.

    A report has one row per window of a round of fits: first some windows for their `shape`, then
    every other window `apart`, then those between, `tied` to their neighbours.
    """

    @property
    def failed(self) -> tuple[bool, ...]:
        """Whether any window failed."""
        return (len(self.failed_windows) > 0,)


def fit_long(
    observations: Sequence[Sensor],
    prior: PriorLike | Stages,
    body: BodyModel | None = None,
    *,
    window: float = WINDOW,
    overlap: float = OVERLAP,
    start: Motion | None = None,
    scene: Scene | None = None,
    weights: Sequence[float] | None = None,
    watch: Watch | None = None,
) -> LongReconstruction:
    """Fit one clip of any length; time grows with the length, memory hardly.

    The recording is cut into overlapping windows. Some, spread over it, are fitted up to the first
    stage that moves the shape; the median of their shapes becomes the shape of all. Then every
    other window is fitted apart from the others, and then those between, tied to the joints of
    their finished neighbours where they overlap (the alternating method of Schwarz in two
    colours). At last, neighbouring windows are blended where they overlap.

    Args:
        observations: sensors with the data of one clip, with a leading axis of length one; the
            first one gives the first guess and the span.
        prior: prior or stages, as for `recon.method.reconstruction.solve`.
        body: body model to be fitted; None is the bundled body.
        window: longest duration of a window, seconds.
        overlap: time that neighbours share, seconds, at most 40 % of a window.
        start: first guess of the whole clip, axes (1, time); None takes it from the data.
        scene: ground and cameras of one clip; windows share it and do not change it.
        weights: multiplier of each observation; None weights all equally.
        watch: called after every iteration; the stage's name begins with that of the round.

    Raises:
        ValueError: when there is no observation or not exactly one clip, one of them cannot be
            cut, or the overlap is none or more than 40 % of a window.
    """
    ready, body, start, scene, weights = checked_arguments(
        observations, body, start, scene, weights
    )
    recording = LongRecording.cut_into_windows(ready, body, window, overlap, start)
    if scene is None:
        scene = Scene.create(1, like=recording.guess.translation)
    job = _WindowFitter(recording, body, scene, weights, watch)
    every = list(range(len(recording.windows.starts)))
    some = torch.linspace(0, every[-1], min(len(every), AT_ONCE)).round().int().tolist()
    stages = stages_of(prior)

    def stages_with_ties(rows: Sequence[int], data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        ties = [
            recording.tie_to_neighbours(row, alone.fitted_neighbours(row), alone.lowest_fps, body)
            for row in rows
        ]
        return with_shape_held(stages((*data, Term("overlap", stack(ties), TIE))))

    shapes = job.fit(
        "shape", some, recording.guess.shape, lambda _, data: until_first_shape_stage(stages(data))
    )
    shape = shapes.median_shape()
    alone = job.fit("apart", every[::2], shape, lambda _, data: with_shape_held(stages(data)))
    tied = job.fit("tied", every[1::2], shape, stages_with_ties)
    motions, rate = alone.motions | tied.motions, min(alone.lowest_fps, tied.lowest_fps)
    joined = joined_windows([motions[row].resample(rate) for row in every])
    whole = joined[None]
    return LongReconstruction(
        estimate=Estimate(Decoded(whole), body.pose(whole), scene),
        windows=tuple(recording.time_range(row) for row in every),
        failed_windows=tuple(sorted({*alone.failed, *tied.failed})),
        reports=(*shapes.reports, *alone.reports, *tied.reports),
    )


@dataclass(frozen=True)
class _WindowFits:
    """Motions of the windows that were fitted in one round, with reports and failures."""

    motions: dict[int, Motion]
    failed: tuple[int, ...]
    reports: tuple[StageReport, ...]

    @property
    def lowest_fps(self) -> float:
        """Lowest frame rate among the windows; fast motions may be fitted at a higher one."""
        return min((motion.fps for motion in self.motions.values()), default=math.inf)

    def fitted_neighbours(self, row: int) -> list[Motion]:
        """Return the fitted motions of the neighbouring windows, without those that failed."""
        fitted = [k for k in (row - 1, row + 1) if k in self.motions and k not in self.failed]
        return [self.motions[k] for k in fitted]

    def median_shape(self) -> Float[Tensor, " shape"]:
        """Return the median shape of the windows that did not fail, or of all if all failed."""
        good = [motion for row, motion in self.motions.items() if row not in self.failed]
        shapes = [motion.shape for motion in good or self.motions.values()]
        return torch.stack(shapes).quantile(0.5, dim=0)


@dataclass(frozen=True)
class _WindowFitter:
    """Fits batches of windows of one recording with a common body, scene and weights."""

    recording: LongRecording
    body: BodyModel
    scene: Scene
    weights: Sequence[float] | None
    watch: Watch | None

    def fit(
        self,
        name: str,
        rows: Sequence[int],
        shape: Float[Tensor, " shape"],
        stages: Callable[[Sequence[int], tuple[Term, ...]], tuple[Stage[Any], ...]],
    ) -> _WindowFits:
        """Fit the windows `rows`, starting from a shape; `stages` takes their rows and data."""
        motions: dict[int, Motion] = {}
        failed: list[int] = []
        reports: list[tuple[StageReport, ...]] = []
        for batch in self.recording.batches_of_equal_clocks(rows):
            parts = zip(*(self.recording.observations_of(row) for row in batch), strict=True)
            result = reconstruct(
                [cast(Any, concatenate)(list(part)) for part in parts],
                partial(stages, batch),
                self.body,
                start=stack([self.recording.first_guess(row, shape) for row in batch]),
                scene=concatenate([self.scene] * len(batch)),
                weights=self.weights,
                watch=self._watch_with_prefix(name),
            )
            for k, row in enumerate(batch):
                motions[row] = result.motion[k].replace(
                    start_time=self.recording.time_range(row)[0]
                )
            failed += [row for row, bad in zip(batch, result.failed, strict=True) if bad]
            reports.append(result.reports)
        order = torch.tensor(list(motions)).argsort()
        merged = [_merged_report(name, stage, order) for stage in zip(*reports, strict=True)]
        return _WindowFits(motions, tuple(failed), tuple(merged))

    def _watch_with_prefix(self, name: str) -> Watch | None:
        watch = self.watch
        if watch is None:
            return None
        return lambda stage, progress: watch(f"{name}: {stage}", progress)


def _merged_report(name: str, parts: Sequence[StageReport], order: Tensor) -> StageReport:
    """Join the reports of batches of windows to one report of a stage."""
    solutions = [part.solution for part in parts]
    steps = max(s.trace.shape[1] for s in solutions)
    traces = [s.trace[:, torch.arange(steps).clamp(max=s.trace.shape[1] - 1)] for s in solutions]
    ended = [reason for s in solutions for reason in s.termination]
    solution = Solution(
        x=torch.cat([s.x for s in solutions])[order],
        value=torch.cat([s.value for s in solutions])[order],
        iterations=torch.cat([s.iterations for s in solutions])[order],
        evaluations=torch.cat([s.evaluations for s in solutions])[order],
        termination=tuple(ended[k] for k in order.tolist()),
        trace=torch.cat(traces)[order],
    )
    stage = replace(parts[0].stage, name=f"{name}: {parts[0].stage.name}")
    remarks = tuple(dict.fromkeys(one for part in parts for one in part.remarks))
    return StageReport(stage, solution, sum(part.seconds for part in parts), remarks=remarks)
