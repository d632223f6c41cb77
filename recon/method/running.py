"""Runs the stages of a fit one after the other, on one or several hypotheses per clip."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, Generic

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.struct import S, concatenate
from recon.method.priors import Prior
from recon.method.protocols import Estimate
from recon.method.stages import ComparedHypotheses, Proposals, Stage, StageReport, Watch
from recon.method.unknowns import Layout, Unknowns, objective
from recon.solver.solution import Solution, joined_in_turn

_ITERATION_SHARE = 3
"""A stage whose correspondences are found anew in rounds has its iterations divided by this."""
_ROUGH = 1e-3
"""Relative decrease below which every round but the last ends: correspondences that are about to
change are not worth more."""


@dataclass(frozen=True)
class Hypotheses(Generic[S]):
    """Variables of one or several hypotheses per clip, one row each."""

    prior: Prior[S]
    unknowns: Unknowns[S]
    clip: Int[Tensor, " rows"] | None = None
    """The clip of every row; None where the rows are the clips."""
    number: Int[Tensor, " rows"] | None = None
    """The caller's number of the hypothesis in every row."""

    @classmethod
    def of_motions(
        cls, prior: Prior[S], motions: Sequence[Motion], scene: Scene, body: BodyModel
    ) -> "Hypotheses[S]":
        """Make one hypothesis of each motion, numbered in order, for every clip of a scene."""
        with torch.no_grad():
            if len(motions) == 1:
                return cls(prior, Unknowns.of(prior, motions[0], scene, body))
            scenes = concatenate([scene] * len(motions))
            unknowns = Unknowns.of(prior, concatenate(list(motions)), scenes, body)
        clips = torch.arange(len(motions[0].translation))
        number = torch.arange(len(motions)).repeat_interleave(len(clips))
        return cls(prior, unknowns, clips.repeat(len(motions)), number)

    @property
    def clips(self) -> Int[Tensor, " rows"]:
        """The index of the clip of every row; with one hypothesis per clip, row k is clip k."""
        return torch.arange(len(self.unknowns.scene.offsets)) if self.clip is None else self.clip

    def best(self, value: Float[Tensor, " rows"], count: int) -> Int[Tensor, " kept"]:
        """Return the `count` rows of lowest value of every clip, in the order of clips."""
        clip, ordered = self.clips, value.cpu().nan_to_num(torch.inf).argsort()
        own = [ordered[clip[ordered] == k][:count] for k in range(int(clip.max()) + 1)]
        return torch.cat(own)

    def with_proposals(
        self, proposals: Proposals, body: BodyModel
    ) -> tuple["Hypotheses[S]", Int[Tensor, " rows"], tuple[str, ...]]:
        """Replace each row by the hypotheses that `proposals` finds for it, if any.

        Returns the new hypotheses, the row from which each came, and remarks.
        """
        clips = self.clips
        parts, origin, told = list[Unknowns[S]](), list[int](), dict[str, None]()
        for row in range(len(self.unknowns.scene.offsets)):
            alone = self.rows(torch.tensor([row]))
            motion, said = proposals(alone.estimate(body), int(clips[row]))
            told |= {said: None} if said else {}
            own = [row] * (1 if motion is None else len(motion.translation))
            origin += own
            if motion is None:
                parts.append(alone.unknowns)
                continue
            scene = self.unknowns.scene[torch.tensor(own)]
            with torch.no_grad():
                parts.append(Unknowns.of_world(self.prior, motion, scene, body))
        rows = torch.tensor(origin)
        number = None if self.number is None else self.number[rows]
        return Hypotheses(self.prior, concatenate(parts), clips[rows], number), rows, tuple(told)

    def rows(self, index: Int[Tensor, " kept"]) -> "Hypotheses[S]":
        """Return the hypotheses of the rows `index`."""
        clip = None if self.clip is None else self.clip[index]
        number = None if self.number is None else self.number[index]
        return Hypotheses(self.prior, self.unknowns[index], clip, number)

    def compared(
        self, value: Float[Tensor, " rows"], kept: Int[Tensor, " kept"], body: BodyModel
    ) -> ComparedHypotheses:
        """Return a record of all hypotheses: their objectives, motions, and which are kept."""
        with torch.no_grad():
            motion = self.unknowns.motion(self.prior, body)
        remains = torch.zeros(len(value), dtype=torch.bool).index_fill(0, kept, True)
        return ComparedHypotheses(
            self.clips, value.detach().cpu(), remains, motion.detach().to(device="cpu")
        )

    def stage_for_rows(self, stage: Stage[S]) -> Stage[S]:
        """Return the stage with its data repeated for the rows: for each the data of its clip."""
        return stage if self.clip is None else stage.rows(self.clip)

    def estimate(self, body: BodyModel) -> Estimate:
        """Return the estimates of all rows, which energies are functions of."""
        with torch.no_grad():
            return self.unknowns.estimate(self.prior, body)


def run_stages(
    stages: Sequence[Stage[Any]],
    body: BodyModel,
    motion: Motion,
    scene: Scene,
) -> tuple[Estimate, list[StageReport]]:
    """Run all stages in turn from one motion per clip; return estimate and stage reports."""
    began = Hypotheses.of_motions(stages[0].prior, [motion], scene, body)
    found, reports = run_hypotheses(stages, body, began)
    return found.estimate(body), reports


def run_hypotheses(
    stages: Sequence[Stage[Any]],
    body: BodyModel,
    initial: Hypotheses[Any],
    watch: Watch | None = None,
) -> tuple[Hypotheses[Any], list[StageReport]]:
    """Run all stages in turn; return the remaining hypotheses and a report of each stage.

    The data of stages have a row for each clip. Consecutive stages of the same prior object
    continue from its variables; between different priors the motion is encoded anew.
    """
    held, reports = initial, list[StageReport]()
    for stage in stages:
        started, remarks = perf_counter(), ()
        if stage.prior is not held.prior:
            held = _encoded_anew(held, stage.prior, body)
        if stage.proposals is not None:
            held, origin, remarks = held.with_proposals(stage.proposals, body)
            reports = [report.rows(origin) for report in reports]
        stage = held.stage_for_rows(stage)
        unknowns, solution = _run_stage(stage, body, held.unknowns, watch)
        held = replace(held, unknowns=unknowns)
        reports.append(StageReport(stage, solution, perf_counter() - started, remarks=remarks))
        if stage.kept is not None:
            value = ranking_objective(stage, held, body) if stage.ranking else solution.value
            index = held.best(value, stage.kept)
            if len(index) < len(value):
                reports[-1] = replace(reports[-1], compared=held.compared(value, index, body))
            held, reports = held.rows(index), [report.rows(index) for report in reports]
    return held, reports


def ranking_objective(
    stage: Stage[Any], hypotheses: Hypotheses[Any], body: BodyModel
) -> Float[Tensor, " rows"]:
    """Return the value by which a stage ranks each row: its `ranking` terms, or its terms."""
    ranked = hypotheses.stage_for_rows(replace(stage, terms=stage.ranking or stage.terms))
    with torch.no_grad():
        estimate = hypotheses.unknowns.estimate(hypotheses.prior, body, stage.portion)
        return ranked.values(estimate).sum(-1)


def _encoded_anew(held: Hypotheses[Any], prior: Prior[Any], body: BodyModel) -> Hypotheses[Any]:
    with torch.no_grad():
        motion = held.unknowns.motion(held.prior, body)
        unknowns = Unknowns.of(prior, motion, held.unknowns.scene, body)
    return replace(held, prior=prior, unknowns=unknowns)


def _run_stage(
    stage: Stage[S], body: BodyModel, unknowns: Unknowns[S], watch: Watch | None
) -> tuple[Unknowns[S], Solution]:
    """Minimise one stage; return the unknowns after it and the solver's report."""
    if not stage.matches:
        return _minimise_once(stage, body, unknowns, watch)
    most = math.ceil(stage.minimiser.max_iterations / _ITERATION_SHARE)
    last = replace(stage.minimiser, max_iterations=most)
    rough = replace(last, tolerance_decrease=max(last.tolerance_decrease, _ROUGH))
    solutions: list[Solution] = []
    for minimiser in (*[rough] * (stage.rounds - 1), last):
        with torch.no_grad():
            estimate = unknowns.estimate(stage.prior, body, stage.portion)
        held = replace(stage, minimiser=minimiser).matched(estimate)
        unknowns, solution = _minimise_once(held, body, unknowns, watch)
        solutions.append(solution)
    return unknowns, joined_in_turn(solutions)


def _minimise_once(
    stage: Stage[S], body: BodyModel, unknowns: Unknowns[S], watch: Watch | None
) -> tuple[Unknowns[S], Solution]:
    start = unknowns.detach()
    told = None if watch is None else partial(watch, stage.name)
    if stage.second_order is not None:
        found = stage.second_order(stage, body, start, told)
        if found is not None:
            return found
    try:
        layout = Layout.of(start, stage.free)
    except ValueError as error:
        raise ValueError(f"stage {stage.name!r}: {error}") from error
    of_layout = objective(stage, body, start, lambda base, x, _: layout.unflatten(base, x))
    solution = stage.minimiser(of_layout, layout.flatten(start), told)
    return layout.unflatten(start, solution.x), solution
