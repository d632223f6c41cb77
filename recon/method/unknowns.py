"""All unknowns of a stage: the prior's variables and the scene, as records and as a matrix."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Generic

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.struct import S, TensorStruct
from recon.method.priors import Prior
from recon.method.protocols import Estimate
from recon.method.stages import Stage
from recon.solver.solution import Objective


@dataclass(frozen=True)
class Unknowns(TensorStruct, Generic[S]):
    """The prior's variables and the scene, both with a leading axis of clips."""

    variables: S
    scene: Scene

    @classmethod
    def of(cls, prior: Prior[S], motion: Motion, scene: Scene, body: BodyModel) -> "Unknowns[S]":
        """Encode a motion that is given in the frame of the recording."""
        if scene.ground is None or not prior.level:
            return cls(prior.encode(motion), scene)
        T = scene.ground.T_world_recording
        variables: Any = prior.encode(motion.carried(T, body.rest_joints(motion.shape)[..., 0, :]))
        return cls(variables.carried(so3.inverse_rigid(T), body), scene)

    @classmethod
    def of_world(
        cls, prior: Prior[S], motion: Motion, scene: Scene, body: BodyModel
    ) -> "Unknowns[S]":
        """Encode a motion that is given in the world, as an `Estimate`'s is."""
        return cls.of(prior, _in_recording(motion, scene, body), scene, body)

    def motion(self, prior: Prior[S], body: BodyModel) -> Motion:
        """Decode the motion, in the frame of the recording."""
        if self.scene.ground is None or not prior.level:
            return prior.decode(self.variables).motion
        return _in_recording(self.estimate(prior, body).motion, self.scene, body)

    def estimate(
        self, prior: Prior[S], body: BodyModel, portion: Callable[[S], S] | None = None
    ) -> Estimate:
        """Decode the estimate for energies, in the world; `portion` selects a part in time."""
        variables: Any = self.variables
        ground = self.scene.ground
        if ground is not None:
            if not hasattr(variables, "carried"):
                raise ValueError(
                    "this prior cannot be fitted with an unknown ground: its variables have no "
                    "method carried(T, body), which turns them into another frame; give the "
                    "cameras' poses, or take the default method"
                )
            variables = variables.carried(ground.T_world_recording, body)
        if portion is not None:
            variables = portion(variables)
        decoded = prior.decode(variables)
        return Estimate(decoded, decoded.body(body), self.scene)


def _in_recording(motion: Motion, scene: Scene, body: BodyModel) -> Motion:
    """Transform a motion from the world to the frame of the recording."""
    if scene.ground is None:
        return motion
    T = so3.inverse_rigid(scene.ground.T_world_recording)
    return motion.carried(T, body.rest_joints(motion.shape)[..., 0, :])


@dataclass(frozen=True)
class Layout:
    """The order of the optimised tensors in the rows of one matrix, a row for each clip."""

    paths: tuple[str, ...]
    shapes: tuple[torch.Size, ...]

    @classmethod
    def of(cls, unknowns: Unknowns[Any], free: Collection[str]) -> "Layout":
        """Return the layout of the tensors named in `free`, in the order of the record.

        Args:
            unknowns: a record with these tensors.
            free: the prior's tensors by their name (`pose`), the scene's by their path
                (`scene.offsets`).

        Raises:
            ValueError: when there is no such tensor; the message lists all tensors.
        """
        tensors = unknowns.tensors()
        named = {path.removeprefix("variables."): path for path in tensors}
        if missing := set(free) - set(named):
            raise ValueError(
                f"a stage frees {sorted(missing)}, which are no variables; expected some of "
                f"{sorted(named)}"
            )
        paths = [path for name, path in named.items() if name in free]
        return cls(tuple(paths), tuple(tensors[path].shape[1:] for path in paths))

    def flatten(self, unknowns: Unknowns[Any]) -> Float[Tensor, "batch n"]:
        """Return the optimised tensors of a record as a matrix with a row for each clip."""
        tensors = unknowns.tensors()
        rows = [tensors[path].reshape(len(tensors[path]), -1) for path in self.paths]
        return torch.cat(rows, 1)

    def unflatten(self, unknowns: Unknowns[S], x: Float[Tensor, "batch n"]) -> Unknowns[S]:
        """Return the record with its optimised tensors replaced by those of a matrix."""
        pieces = x.split([shape.numel() for shape in self.shapes], 1)
        freed = {
            path: piece.reshape(len(x), *shape)
            for path, piece, shape in zip(self.paths, pieces, self.shapes, strict=True)
        }
        paths = iter(unknowns.tensors())
        return unknowns.map(lambda tensor: freed.get(next(paths), tensor))


def rows_of(
    stage: Stage[S], unknowns: Unknowns[S], rows: Int[Tensor, " rows"]
) -> tuple[Stage[S], Unknowns[S]]:
    """Return stage and unknowns of the clips `rows` only, which are in ascending order."""
    if len(rows) == len(unknowns.scene.offsets):
        return stage, unknowns
    return stage.rows(rows), unknowns[rows]


def objective(
    stage: Stage[S],
    body: BodyModel,
    start: Unknowns[S],
    moved: Callable[[Unknowns[S], Tensor, Tensor], Unknowns[S]],
) -> Objective:
    """Return a stage's weighted terms as a function of a solver's variables and clip numbers.

    Args:
        stage: with the data of all clips.
        body: whose motion it is.
        start: unknowns of all clips.
        moved: unknowns of some clips at the solver's variables: called with those of `start`,
            these variables and the numbers of the clips.
    """
    cached, cached_rows = (stage, start), torch.arange(len(start.scene.offsets))

    def terms(x: Float[Tensor, "active n"], active: Int[Tensor, " active"]) -> Tensor:
        nonlocal cached, cached_rows
        if active is not cached_rows:  # the same object means the same rows
            cached, cached_rows = rows_of(stage, start, active), active
        some, base = cached
        return some.values(moved(base, x, active).estimate(some.prior, body, some.portion))

    return terms
