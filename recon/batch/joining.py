"""Problems of several clips as one batch, whose solution is taken apart again.

A fit of one clip knows its noise, and with it the weights of its energies; they stay its own
when it is joined with others. Clips that are shorter than the longest get frames that do not
exist (`Motion.valid`), which change nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Protocol, cast, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.motion import Motion, pad
from recon.core.scene import Scene
from recon.core.struct import TensorStruct, concatenate
from recon.method.alike import alike
from recon.method.protocols import REFERENCE_FPS, Decoded, Energy, Estimate, Sensor
from recon.method.quadratic import ClipModel
from recon.method.reconstruction import Problem, Reconstruction
from recon.method.running import run_stages
from recon.method.stages import Matched, Stage, StageReport
from recon.method.terms import Term

_ABOUT = 1e-6
"""Seconds by which clocks may differ."""


@dataclass(frozen=True)
class Member:
    """A problem, and the same with a clock that begins at zero."""

    asked: Problem
    moved: Problem
    """The problem with its clock set back, as others have other times of day."""

    @classmethod
    def of(cls, problem: Problem) -> "Member | None":
        """The problem as it may be joined; None where it cannot be.

        An observation may have no clock to set back. And hypotheses of one clip that are compared
        with each other would be told apart by their rows, as those of other clips are.
        """
        if problem.others or not all(isinstance(one, Sensor) for one in problem.observations):
            return None
        begin, seen = problem.start.start_time, _sensors(problem)
        moved = tuple(one.derived(start_time=one.start_time - begin) for one in seen)
        start = problem.start.replace(start_time=0.0)
        member = cls(problem, replace(problem, observations=moved, start=start))
        proposes = any(stage.proposals is not None for stage in member.stages)
        return None if proposes else member

    @cached_property
    def stages(self) -> tuple[Stage[Any], ...]:
        """The stages of the problem as it was asked for."""
        return self.asked.stages()

    @property
    def rows(self) -> int:
        """Number of clips, or of hypotheses of one."""
        return len(self.asked.start.translation)

    @property
    def lengths(self) -> tuple[int, ...]:
        """Numbers of frames and of every sensor's moments."""
        return (self.asked.start.frames, *(one.moments for one in _sensors(self.asked)))

    @property
    def stretchable(self) -> bool:
        """Whether frames that do not exist change nothing at all.

        Where a sensor has another clock than the motion, its last moments may lie after the last
        frame; they would be compared with a frame that does not exist.
        """
        clocks = {one.fps for one in _sensors(self.asked)} | {self.asked.start.fps}
        return clocks == {REFERENCE_FPS} and bool(self.asked.start.valid.all())

    def beside(self, other: "Member") -> bool:
        """Whether both may be joined, as far as can be told without their stages."""
        a, b = self.moved, other.moved
        return (
            len(a.observations) == len(b.observations)
            and a.start.fps == b.start.fps
            and a.start.shape.shape[-1] == b.start.shape.shape[-1]
            and a.scene.offsets.shape[1:] == b.scene.offsets.shape[1:]
            and (a.scene.ground is None) == (b.scene.ground is None)
            and (a.scene.lens is None) == (b.scene.lens is None)
            and all(map(_beside, _sensors(a), _sensors(b)))
            and (self.lengths == other.lengths or (self.stretchable and other.stretchable))
            and alike(a.body, b.body)
        )

    def stretched(self, lengths: Sequence[int]) -> Problem:
        """The problem on the common clock with so many frames and moments of every sensor.

        Those that it does not have are marked as not existing, and show nothing.
        """
        if tuple(lengths) == self.lengths:
            return self.moved
        start = self.moved.start
        longest = _longer(start[0], lengths[0])
        longer = pad([*(start[row] for row in range(self.rows)), longest])[: self.rows]
        seen = tuple(
            one.window(one.start_time, one.start_time + (count - 1) / one.fps)
            for one, count in zip(_sensors(self.moved), lengths[1:], strict=True)
        )
        return replace(self.moved, observations=seen, start=longer)

    def solution(
        self, estimate: Estimate, reports: Sequence[StageReport], rows: Tensor
    ) -> Reconstruction:
        """This problem's part of a joined solution, on its own clock and of its own length.

        Args:
            estimate: of all problems.
            reports: of the joined stages.
            rows: which rows of both are of this problem.
        """
        found, count = estimate.decoded, len(estimate.motion.translation)
        motion = found.motion[rows]
        # a prior may have brought the motion to another rate
        frames = int(motion.valid.sum(-1).max())
        motion = motion.window(0, frames).replace(start_time=self.asked.start.start_time)
        decoded = Decoded(
            motion=motion,
            energies={name: energy[rows] for name, energy in found.energies.items()},
            contacts=None if found.contacts is None else found.contacts[rows][:, :frames],
            joints=None if found.joints is None else found.joints[rows][:, :frames],
        )
        own = tuple(
            StageReport(stage, report.solution.rows(rows), report.seconds * len(rows) / count)
            for stage, report in zip(self.stages, reports, strict=True)
        )
        scene: Scene = estimate.scene[rows]
        return Reconstruction(Estimate(decoded, self.asked.body.pose(motion), scene), own)


def _sensors(problem: Problem) -> tuple[Sensor, ...]:
    found: Any = problem.observations  # `Member.of` takes no others
    return found


def _beside(a: Sensor, b: Sensor) -> bool:
    return (
        type(a) is type(b)
        and a.fps == b.fps
        and abs(a.start_time - b.start_time) < _ABOUT
        and a.shown.shape[2:] == b.shown.shape[2:]
    )


def _longer(motion: Motion, frames: int) -> Motion:
    """The first so many frames, the last one repeated where there are not as many."""
    index = torch.arange(frames).clamp(max=motion.frames - 1).to(motion.translation.device)
    return motion.replace(
        translation=motion.translation[index],
        rotations=motion.rotations[index],
        valid=motion.valid[index],
    )


_COMPARED = tuple(one.name for one in fields(Stage) if one.name not in ("prior", "terms"))
"""What stages have besides their prior and terms."""


@runtime_checkable
class Shared(Protocol):
    """A prior that can be joined with others of its class that differ in how they encode only."""

    def decodes_like(self, other: Any) -> bool:
        """Whether both decode the same variables to the same motions and energies."""
        ...


def solve_joined(members: Sequence[Member]) -> list[Reconstruction | None]:
    """Solutions of problems that stand beside each other (`Member.beside`).

    None for those whose stages differ from the first one's by more than weights.
    """
    lengths = [max(row) for row in zip(*(one.lengths for one in members), strict=True)]
    problems = [one.stretched(lengths) for one in members]
    stages = [problem.stages() for problem in problems]
    kept = [k for k in range(len(members)) if k == 0 or _one_course(stages[0], stages[k])]
    counts = [members[k].rows for k in kept]
    estimate, reports = run_stages(
        _joined([stages[k] for k in kept], counts),
        problems[0].body,
        concatenate([problems[k].start for k in kept]),
        concatenate([problems[k].scene for k in kept]),
    )
    every = torch.arange(sum(counts), device=estimate.motion.translation.device)
    found: list[Reconstruction | None] = [None] * len(members)
    for k, rows in zip(kept, every.split(counts), strict=True):
        found[k] = members[k].solution(estimate, reports, rows)
    return found


def _one_course(a: Sequence[Stage[Any]], b: Sequence[Stage[Any]]) -> bool:
    """Whether stages are the same but for weights, data, and how their priors encode."""
    return len(a) == len(b) and all(map(_one_stage, a, b))


def _one_stage(a: Stage[Any], b: Stage[Any]) -> bool:
    return (
        a.reweighting is None  # it would find one set of weights for all clips
        and all(alike(getattr(a, name), getattr(b, name)) for name in _COMPARED)
        and [term.name for term in a.terms] == [term.name for term in b.terms]
        and all(_one_energy(x.energy, y.energy) for x, y in zip(a.terms, b.terms, strict=True))
        and _one_decoder(a.prior, b.prior)
    )


def _one_decoder(a: Any, b: Any) -> bool:
    if type(a) is not type(b):
        return False
    return a.decodes_like(b) if isinstance(a, Shared) else alike(a, b)


def _one_energy(a: Energy, b: Energy) -> bool:
    """Whether energies are one function, or records whose tensors can stand in one batch."""
    if not isinstance(a, TensorStruct) or not isinstance(b, TensorStruct):
        return alike(a, b)
    if type(a) is not type(b):
        return False
    x, y = a.tensors(), b.tensors()
    return (
        list(x) == list(y)
        and all(x[path].shape[1:] == y[path].shape[1:] for path in x)
        and alike(_settings(a), _settings(b))
    )


def _settings(record: TensorStruct) -> list[Any]:
    """What a record has besides tensors; clocks to a microsecond (`Member.beside`)."""
    found: list[Any] = []
    for field in fields(cast(Any, record)):
        value = getattr(record, field.name)
        if isinstance(value, TensorStruct):
            found.append(_settings(value))
        elif not isinstance(value, Tensor) and field.name != "start_time":
            found.append(value)
    return found


def _joined(courses: Sequence[tuple[Stage[Any], ...]], counts: Sequence[int]) -> list[Stage[Any]]:
    """The stages of all problems as those of one batch."""
    priors: dict[tuple[int, ...], _Joint] = {}
    stages: list[Stage[Any]] = []
    for same in zip(*courses, strict=True):
        own = tuple(stage.prior for stage in same)
        # stages of one prior go on from its variables, so they need one object
        prior = priors.setdefault(tuple(map(id, own)), _Joint(own, tuple(counts)))
        terms = zip(*(stage.terms for stage in same), strict=True)
        joined = tuple(_joined_term(several, counts) for several in terms)
        stages.append(replace(same[0], prior=prior, terms=joined))
    return stages


def _joined_term(terms: Sequence[Term], counts: Sequence[int]) -> Term:
    first = terms[0]
    energy = first.energy
    if isinstance(energy, TensorStruct):
        records: list[Any] = [term.energy for term in terms]
        energy = cast(Energy, concatenate(records))
    weights = [term.weight for term in terms]
    if len(set(weights)) == 1:
        return Term(first.name, energy, first.weight)
    each = torch.tensor(weights).repeat_interleave(torch.tensor(counts))
    kind = _WeightedMatches if isinstance(energy, Matched) else _Weighted
    return Term(first.name, kind(each, energy), 1.0)


@dataclass(frozen=True)
class _Weighted(TensorStruct):
    """An energy that every clip weighs in its own way."""

    weights: Float[Tensor, " clips"]
    energy: Any

    def __call__(self, estimate: Estimate) -> Float[Tensor, " clips"]:
        found = self.energy(estimate)
        return self.weights.to(found) * found

    def of_clip(self, clip: int) -> tuple[float, Energy]:
        """The weight of a clip, and the energy that is weighed."""
        return float(self.weights[clip]), self.energy


@dataclass(frozen=True)
class _WeightedMatches(_Weighted):
    """A weighted energy over correspondences, which are found anew between minimisations."""

    def matched(self, estimate: Estimate) -> Energy:
        """The energy over the correspondences of this estimate, weighted likewise."""
        return _Weighted(self.weights, self.energy.matched(estimate))


@dataclass(frozen=True, eq=False)
class _Joint:
    """Priors of several problems that decode alike; each encodes its own clips."""

    priors: tuple[Any, ...]
    counts: tuple[int, ...]

    @property
    def level(self) -> bool:
        """Whether their motions are in the world (`recon.method.unknowns.Level`)."""
        return getattr(self.priors[0], "level", False)

    def encode(self, motion: Motion) -> Any:
        """Variables of every problem's motions by its own prior.

        Of some of the clips, as a solver begins anew with those that are not done, they are the
        first prior's: units of variables differ, and what they decode to does not.
        """
        if len(motion.translation) != sum(self.counts):
            return self.priors[0].encode(motion)
        rows = torch.arange(sum(self.counts), device=motion.translation.device)
        parts = zip(self.priors, rows.split(self.counts), strict=True)
        return concatenate([prior.encode(motion[own]) for prior, own in parts])

    def decode(self, variables: Any) -> Decoded:
        """What any of them decodes."""
        return self.priors[0].decode(variables)

    @property
    def reach(self) -> int:
        """Frames up to so far apart couple; see `recon.method.quadratic.Framewise`."""
        return self.priors[0].reach

    def from_steps(self, variables: Any, steps: Float[Tensor, "clips time 69"]) -> Any:
        """Variables after steps of frames; what they mean is how they are decoded."""
        return self.priors[0].from_steps(variables, steps)

    def turns(self, variables: Any, clip: int) -> Float[Tensor, "time 63 63"]:
        """Derivatives of the joints' rotations by steps of the pose."""
        return self.priors[0].turns(variables, clip)

    def add_curvature(self, term: Term, clip: ClipModel) -> bool:
        """Add the Hessian of a term of the prior."""
        return self.priors[0].add_curvature(term, clip)
