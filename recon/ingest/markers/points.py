"""Poses of a body, and points of its skin in them with their derivatives."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.derivatives import CarriedPoints
from recon.body.kinematics import forward_kinematics
from recon.body.levers import Levers, ShapeLevers, affine, gathered, turned, world_turns
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.struct import TensorStruct


@dataclass(frozen=True)
class Poses(TensorStruct):
    """Poses of frames, with what follows from them."""

    translation: Float[Tensor, "frames 3"]
    rotations: Float[Tensor, "frames 22 3 3"]
    orientations: Float[Tensor, "frames 22 3 3"]
    """Orientations of the bones, world."""
    bones: Float[Tensor, "frames 3 88"]
    """Affine matrices of all bones; see `recon.body.levers`."""

    @classmethod
    def of(
        cls,
        translation: Float[Tensor, "frames 3"],
        rotations: Float[Tensor, "frames 22 3 3"],
        rest: Float[Tensor, "22 3"],
    ) -> "Poses":
        """Poses of a body with joints at these places at rest, metres."""
        orientations, joints = forward_kinematics(rotations, rest)
        placed = affine(orientations, joints + translation[:, None])
        return cls(translation, rotations, orientations, placed)

    def moved(self, steps: Float[Tensor, "frames 69"], rest: Float[Tensor, "22 3"]) -> "Poses":
        """Poses after a step of every frame, in the coordinates of `recon.body.levers`."""
        rotations = turned(self.rotations, self.orientations, steps[:, 3:])
        return Poses.of(self.translation + steps[:, :3], rotations, rest)


@dataclass(frozen=True)
class Correctives(TensorStruct):
    """Displacements of skin that depend on the pose, as bodies of the SMPL family have them."""

    directions: Float[Tensor, "189 columns"]
    """Displacements of all unposed points, metres, by the entries of all body rotations."""
    weights: Float[Tensor, "points 22"]

    @classmethod
    def of(cls, body: BodyModel, vertices: Int[Tensor, " points"]) -> "Correctives | None":
        """Correctives of some vertices; None for a body that has none."""
        if body.pose_directions is None:
            return None
        return cls(body.pose_directions[:, vertices].flatten(1), body.weights[vertices])

    def moved(self, poses: Poses) -> Float[Tensor, "frames 3 points"]:
        """The displacements, world, metres."""
        return (self._turns(poses) @ self._unposed(poses)[..., None])[..., 0].mT

    def pull(
        self, poses: Poses, forces: Float[Tensor, "frames 3 points"]
    ) -> Float[Tensor, "frames 69"]:
        """Derivatives of Σ forces · displacements by the coordinates of a step."""
        loads = torch.einsum("vj,tdv,tva->tdja", self.weights, forces, self._unposed(poses))
        bones = poses.orientations.transpose(1, 2)
        turns = gathered(torch.linalg.cross(bones, loads, dim=1).sum(-1)).flatten(1)
        local = (self._turns(poses).mT @ forces.mT[..., None])[..., 0].flatten(1)
        slopes = (local @ self.directions.mT).unflatten(-1, (-1, 3, 3))
        bent = 2 * so3.axis_sine(poses.rotations[:, 1:].mT @ slopes)
        turns = turns + world_turns(_rootless(bent), poses.orientations)
        return torch.nn.functional.pad(turns, (3, 0))

    def _unposed(self, poses: Poses) -> Float[Tensor, "frames points 3"]:
        body = poses.rotations[:, 1:] - torch.eye(3).to(poses.rotations)
        return (body.flatten(1) @ self.directions).unflatten(-1, (-1, 3))

    def _turns(self, poses: Poses) -> Float[Tensor, "frames points 3 3"]:
        return torch.einsum("vj,tjab->tvab", self.weights, poses.orientations)


@dataclass(frozen=True)
class SkinPoints(TensorStruct):
    """Points at constant offsets from vertices of a body of known shape.

    Correctives are part of the places and of `pull`, and left out of second derivatives.
    """

    carried: CarriedPoints
    levers: Levers
    correctives: Correctives | None

    @classmethod
    def of(
        cls,
        body: BodyModel,
        shape: Float[Tensor, " shape"],
        vertices: Int[Tensor, " points"],
        offsets: Float[Tensor, "points 3"] | None = None,
    ) -> "SkinPoints":
        """Vertices, with offsets in the frames of the bones that move them most, metres."""
        eye = torch.eye(len(vertices), dtype=shape.dtype, device=shape.device)
        none = shape.new_zeros(len(eye), body.weights.shape[-1])
        carried = CarriedPoints.create(body, shape, none, eye, vertices)
        if offsets is not None:
            place = carried.place.clone()
            place[torch.arange(len(eye)), body.weights[vertices].argmax(-1)] += offsets
            carried = replace(carried, place=place)
        return cls(carried, Levers.of(carried), Correctives.of(body, vertices))

    def places(self, poses: Poses) -> Float[Tensor, "frames 3 points"]:
        """The points, world, metres."""
        places = self.levers.places(poses.bones)
        return places if self.correctives is None else places + self.correctives.moved(poses)

    def pull(
        self, poses: Poses, forces: Float[Tensor, "frames 3 points"]
    ) -> Float[Tensor, "frames 69"]:
        """Derivatives of Σ forces · points by the coordinates of a step."""
        pull = self.levers.pull(poses.bones, forces)
        return pull if self.correctives is None else pull + self.correctives.pull(poses, forces)

    def by_shape(self, poses: Poses, body: BodyModel) -> Float[Tensor, "frames points 3 shape"]:
        """Derivatives of the points by the coefficients of the shape, metres."""
        return ShapeLevers.of(self.carried, body).by_shape(poses.bones)


def _rootless(bent: Float[Tensor, "frames 21 3"]) -> Float[Tensor, "frames 22 3"]:
    """Vectors of all joints from those of the body joints; zero for the root."""
    return torch.nn.functional.pad(bent, (0, 0, 1, 0))
