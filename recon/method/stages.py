"""A method is a tuple of stages; this is the loop over them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, ClassVar, Generic, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.struct import S, TensorStruct
from recon.method.protocols import Energy, Estimate, Prior
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS, Progress, Solution
from recon.solver.solution import in_turn

_ROUNDS, _SHARE = 5, 3
"""A stage whose energies hold on to pairs is minimised so many times, finding them anew; each time
with a share of its iterations."""


@runtime_checkable
class Matched(Protocol):
    """An energy over pairs, such as points and the nearest place of a surface.

    Minimised while it looks for the nearest, it jumps where pairs change, and line searches end
    there. So pairs are held, and found anew between minimisations (iterated closest points).
    """

    def matched(self, estimate: Estimate) -> Energy:
        """The energy over the pairs of this estimate."""
        ...


@dataclass(frozen=True)
class Stage(Generic[S]):
    """One minimisation: a prior's variables, the terms of the objective, and the minimiser."""

    name: str
    prior: Prior[S]
    terms: tuple[Term, ...]
    free: frozenset[str]
    """Names of the optimised tensors, the prior's (`pose`) or the scene's (`scene.offsets`)."""
    minimiser: LBFGS = LBFGS()
    frames: int | None = None
    """Number of frames that are decoded and compared, from the first on; the prior's `decode` must
    then take this number beside the variables. None decodes all frames."""

    def __post_init__(self) -> None:
        names = [term.name for term in self.terms]
        if len(names) == 0 or len(set(names)) < len(names):
            raise ValueError(f"stage {self.name!r} needs terms with names of their own: {names}")

    def held(self, estimate: Estimate) -> "Stage[S]":
        """The stage with the correspondences of an estimate, fixed while it is minimised."""
        terms = tuple(
            replace(term, energy=term.energy.matched(estimate))
            if isinstance(term.energy, Matched)
            else term
            for term in self.terms
        )
        return replace(self, terms=terms)


@dataclass(frozen=True)
class Unknowns(TensorStruct, Generic[S]):
    """Everything a stage may move."""

    variables: S
    scene: Scene


@dataclass(frozen=True)
class StageReport:
    """How one stage ended for each clip of the batch."""

    stage: Stage[Any]
    solution: Solution
    seconds: float

    def rows(self, index: Int[Tensor, " rows"]) -> "StageReport":
        """The report for some clips of the batch."""
        return replace(self, solution=self.solution.rows(index))


@runtime_checkable
class Carried(Protocol):
    """Variables of a motion that can be had in another frame."""

    def carried(self, T: Float[Tensor, "*batch 4 4"], body: BodyModel) -> Any:
        """Variables of the same motion after a rigid transform."""
        ...


@runtime_checkable
class Level(Protocol):
    """A prior that knows where up is: its motions are in the world, not in a recording's frame.

    Where the ground is unknown, motions are brought to the world before `encode`, and its
    variables, which are `Carried`, back to the frame of the recording.
    """

    level: ClassVar[bool]


Watch = Callable[[str, Progress], bool | None]
"""Told the stage's name and how far its minimisation has come; True ends that stage."""


def run_stage(
    stage: Stage[S],
    body: BodyModel,
    variables: S,
    scene: Scene,
    watch: Watch | None = None,
) -> tuple[S, Scene, Solution]:
    """Minimise one stage's objective from the given variables.

    Raises:
        ValueError: when the stage frees a tensor that its prior and the scene do not have.
    """
    if not any(isinstance(term.energy, Matched) for term in stage.terms):
        return _minimise(stage, body, variables, scene, watch)
    most = math.ceil(stage.minimiser.max_iterations / _SHARE)
    shorter = replace(stage, minimiser=replace(stage.minimiser, max_iterations=most))
    solutions: list[Solution] = []
    for _ in range(_ROUNDS):
        held = shorter.held(evaluate_stage(shorter, body, variables, scene))
        variables, scene, solution = _minimise(held, body, variables, scene, watch)
        solutions.append(solution)
    return variables, scene, in_turn(solutions)


def _minimise(
    stage: Stage[S], body: BodyModel, variables: S, scene: Scene, watch: Watch | None
) -> tuple[S, Scene, Solution]:
    start = Unknowns(variables, scene).detach()
    layout = _Layout.of(start, _free_paths(stage, start))
    bound = stage.terms, start
    bound_to: Tensor | None = None

    def objective(x: Float[Tensor, "active n"], active: Int[Tensor, " active"]) -> Tensor:
        nonlocal bound, bound_to
        if active is not bound_to:  # the solver hands the same tensor until the rows change
            bound = tuple(term.rows(active) for term in stage.terms), start[active]
            bound_to = active
        terms, fixed = bound
        estimate = _estimate(stage.prior, body, layout.unflatten(fixed, x), stage.frames)
        return torch.stack([term.weight * term.energy(estimate) for term in terms], -1)

    told = None if watch is None else partial(watch, stage.name)
    solution = stage.minimiser(objective, layout.flatten(start), told)
    found = layout.unflatten(start, solution.x)
    return found.variables, found.scene, solution


def evaluate_stage(stage: Stage[S], body: BodyModel, variables: S, scene: Scene) -> Estimate:
    """The estimate of a stage's variables, all that its energies would see."""
    with torch.no_grad():
        return _estimate(stage.prior, body, Unknowns(variables, scene))


def run_stages(
    stages: Sequence[Stage[Any]],
    body: BodyModel,
    motion: Motion,
    scene: Scene,
    watch: Watch | None = None,
) -> tuple[Estimate, list[StageReport]]:
    """All stages in turn.

    Consecutive stages of one prior object continue from its variables; otherwise the baton is
    the motion, encoded anew.
    """
    prior: Prior[Any] | None = None
    variables: Any = None
    reports: list[StageReport] = []
    for stage in stages:
        began = perf_counter()
        if stage.prior is not prior:
            with torch.no_grad():
                prior, variables = stage.prior, _encoded(stage.prior, body, motion, scene)
        variables, scene, solution = run_stage(stage, body, variables, scene, watch)
        with torch.no_grad():
            motion = _motion(stage.prior, body, variables, scene)
        reports.append(StageReport(stage, solution, perf_counter() - began))
    return evaluate_stage(stages[-1], body, variables, scene), reports


def _encoded(prior: Prior[S], body: BodyModel, motion: Motion, scene: Scene) -> S:
    """Variables, in the recording's frame, of a motion in the recording's frame."""
    if scene.ground is None or not _is_level(prior):
        return prior.encode(motion)
    T = scene.ground.T_world_recording
    variables: Any = prior.encode(motion.carried(T, body.rest_joints(motion.shape)[..., 0, :]))
    return variables.carried(so3.inverse_rigid(T), body)


def _motion(prior: Prior[S], body: BodyModel, variables: S, scene: Scene) -> Motion:
    """The motion of variables, both in the recording's frame."""
    if scene.ground is None or not _is_level(prior):
        return prior.decode(variables).motion
    motion = _estimate(prior, body, Unknowns(variables, scene)).motion
    T = so3.inverse_rigid(scene.ground.T_world_recording)
    return motion.carried(T, body.rest_joints(motion.shape)[..., 0, :])


def _is_level(prior: Prior[Any]) -> bool:
    return isinstance(prior, Level) and prior.level


def _estimate(
    prior: Prior[S], body: BodyModel, unknowns: Unknowns[S], frames: int | None = None
) -> Estimate:
    some: Any = prior
    variables, ground = unknowns.variables, unknowns.scene.ground
    if ground is not None:
        if not isinstance(variables, Carried):
            raise ValueError(
                f"{type(prior).__name__} needs to know the ground: its variables cannot be "
                "carried to another world; give the cameras' poses, or take the default method"
            )
        variables = variables.carried(ground.T_world_recording, body)
    decoded = some.decode(variables, *(() if frames is None else (frames,)))
    return Estimate(decoded, body.pose(decoded.motion), unknowns.scene)


def _free_paths(stage: Stage[Any], start: TensorStruct) -> list[str]:
    """The freed tensors by their path in `Unknowns`, in its order."""
    named = {path.removeprefix("variables."): path for path in start.tensors()}
    if unknown := stage.free - set(named):
        raise ValueError(
            f"stage {stage.name!r} frees {sorted(unknown)}; there are {sorted(named)}"
        )
    return [path for name, path in named.items() if name in stage.free]


@dataclass(frozen=True)
class _Layout:
    """How the freed tensors of a batch lie side by side in one matrix of variables."""

    paths: tuple[str, ...]
    shapes: tuple[torch.Size, ...]

    @classmethod
    def of(cls, record: TensorStruct, paths: list[str]) -> "_Layout":
        tensors = record.tensors()
        return cls(tuple(paths), tuple(tensors[path].shape[1:] for path in paths))

    def flatten(self, record: TensorStruct) -> Float[Tensor, "batch n"]:
        tensors = record.tensors()
        rows = [tensors[path].reshape(len(tensors[path]), -1) for path in self.paths]
        return torch.cat(rows, 1)

    def unflatten(self, record: S, x: Float[Tensor, "batch n"]) -> S:
        pieces = x.split([shape.numel() for shape in self.shapes], 1)
        freed = {
            path: piece.reshape(len(x), *shape)
            for path, piece, shape in zip(self.paths, pieces, self.shapes, strict=True)
        }
        paths = iter(record.tensors())
        return record.map(lambda tensor: freed.get(next(paths), tensor))
