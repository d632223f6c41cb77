"""Energies of poses, given observed markers, with gradients and Gauss-Newton Hessians."""

from dataclasses import dataclass, replace
from functools import cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from priors.pose.prior import PoseDensity, PosePrior
from recon.body.derivatives import BonePoints
from recon.body.levers import (
    COORDINATES,
    Levers,
    ShapeLevers,
    bone_affines,
    flat_world_vectors,
    rotations_after_turns,
    sums_over_descendants,
)
from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from recon.core.struct import TensorStruct
from recon.ingest.tied_frames import TiedFrames


@dataclass(frozen=True)
class Poses(TensorStruct):
    """Poses of a body in some frames, and the bone orientations and affines that they imply."""

    translation: Float[Tensor, "frames 3"]
    rotations: Float[Tensor, "frames 22 3 3"]
    orientations: Float[Tensor, "frames 22 3 3"]
    """Rotations from the bones' axes at rest to the world."""
    bones: Float[Tensor, "frames 3 88"]
    """Affine matrices of all bones, in the layout of `recon.body.levers`."""

    @classmethod
    def of(
        cls,
        translation: Float[Tensor, "frames 3"],
        rotations: Float[Tensor, "frames 22 3 3"],
        rest: Float[Tensor, "22 3"],
    ) -> "Poses":
        """Return poses of a body whose joints at rest are at `rest`, metres."""
        orientations, joints = forward_kinematics(rotations, rest)
        placed = bone_affines(orientations, joints + translation[:, None])
        return cls(translation, rotations, orientations, placed)

    def moved(self, steps: Float[Tensor, "frames 69"], rest: Float[Tensor, "22 3"]) -> "Poses":
        """Return the poses after a step of each frame (coordinates of `recon.body.levers`)."""
        rotations = rotations_after_turns(self.rotations, self.orientations, steps[:, 3:])
        return Poses.of(self.translation + steps[:, :3], rotations, rest)


@dataclass(frozen=True)
class PoseBlendShapes(TensorStruct):
    """Displacements of skin points that depend on the pose (pose blend shapes of SMPL bodies)."""

    directions: Float[Tensor, "189 columns"]
    """Displacements of all unposed points, metres, by the entries of all body rotations."""
    weights: Float[Tensor, "points 22"]

    @classmethod
    def of(cls, body: BodyModel, vertices: Int[Tensor, " points"]) -> "PoseBlendShapes | None":
        """Return the blend shapes of some vertices; None for a body that has none."""
        if body.pose_directions is None:
            return None
        return cls(body.pose_directions[:, vertices].flatten(1), body.weights[vertices])

    def displacements(self, poses: Poses) -> Float[Tensor, "frames 3 points"]:
        """Return the displacements of the points in given poses; world axes, metres."""
        return (self._blended_rotations(poses) @ self._local_offsets(poses)[..., None])[..., 0].mT

    def gradient_by_rotations(
        self, poses: Poses, forces: Float[Tensor, "frames 3 points"]
    ) -> Float[Tensor, "frames 69"]:
        """Return derivatives of Σ forces · displacements by the coordinates of a step."""
        loads = torch.einsum("vj,tdv,tva->tdja", self.weights, forces, self._local_offsets(poses))
        bones = poses.orientations.transpose(1, 2)
        turns = sums_over_descendants(torch.linalg.cross(bones, loads, dim=1).sum(-1)).flatten(1)
        local = (self._blended_rotations(poses).mT @ forces.mT[..., None])[..., 0].flatten(1)
        slopes = (local @ self.directions.mT).unflatten(-1, (-1, 3, 3))
        bent = 2 * so3.axis_sine(poses.rotations[:, 1:].mT @ slopes)
        turns = turns + flat_world_vectors(pad(bent, (0, 0, 1, 0)), poses.orientations)
        return pad(turns, (3, 0))

    def _local_offsets(self, poses: Poses) -> Float[Tensor, "frames points 3"]:
        body = poses.rotations[:, 1:] - torch.eye(3).to(poses.rotations)
        return (body.flatten(1) @ self.directions).unflatten(-1, (-1, 3))

    def _blended_rotations(self, poses: Poses) -> Float[Tensor, "frames points 3 3"]:
        return torch.einsum("vj,tjab->tvab", self.weights, poses.orientations)


@dataclass(frozen=True)
class SkinPoints(TensorStruct):
    """Points, such as markers, at constant offsets from vertices of a body of known shape.

    Pose blend shapes (`correctives`) are left out of the second derivatives.
    """

    carried: BonePoints
    levers: Levers
    correctives: PoseBlendShapes | None

    @classmethod
    def of(
        cls,
        body: BodyModel,
        shape: Float[Tensor, " shape"],
        vertices: Int[Tensor, " points"],
        offsets: Float[Tensor, "points 3"] | None = None,
    ) -> "SkinPoints":
        """Return points at vertices plus offsets (m) in the frames of the vertices' main bones."""
        eye = torch.eye(len(vertices), dtype=shape.dtype, device=shape.device)
        none = shape.new_zeros(len(eye), body.weights.shape[-1])
        carried = BonePoints.create(body, shape, none, eye, vertices)
        if offsets is not None:
            place = carried.place.clone()
            place[torch.arange(len(eye)), body.weights[vertices].argmax(-1)] += offsets
            carried = replace(carried, place=place)
        return cls(carried, Levers.of(carried), PoseBlendShapes.of(body, vertices))

    def places(self, poses: Poses) -> Float[Tensor, "frames 3 points"]:
        """Return the positions of the points in given poses; world, metres."""
        places = self.levers.positions(poses.bones)
        return (
            places if self.correctives is None else places + self.correctives.displacements(poses)
        )

    def gradient_by_rotations(
        self, poses: Poses, forces: Float[Tensor, "frames 3 points"]
    ) -> Float[Tensor, "frames 69"]:
        """Return derivatives of Σ forces · points by the coordinates of a step."""
        gradient = self.levers.gradient_of(poses.bones, forces)
        return (
            gradient
            if self.correctives is None
            else gradient + self.correctives.gradient_by_rotations(poses, forces)
        )

    def jacobian_by_shape(
        self, poses: Poses, body: BodyModel
    ) -> Float[Tensor, "frames points 3 shape"]:
        """Return derivatives of the points (m) by the shape coefficients."""
        return ShapeLevers.of(self.carried, body).jacobian_by_shape(poses.bones)


@cache
def pose_density() -> PoseDensity:
    """Load the density of poses of the bundled pose prior; it is kept for later calls."""
    return PosePrior.load().density


@cache
def natural_pose() -> Float[Tensor, "21 3 3"]:
    """Return a relaxed standing pose, which is used for joints that no marker determines.

    It is the mean rotation of every body joint over the motions that the bundled pose prior
    learned.
    """
    return pose_density().mean.float()


def drawn_poses(count: int) -> Float[Tensor, "count 21 3 3"]:
    """Draw poses from the bundled pose prior at random, the same ones in every call."""
    draw, density = torch.Generator().manual_seed(0), pose_density()
    z = torch.randn(count, len(density.basis), generator=draw, dtype=density.basis.dtype)
    return density.rotations(z).float()


def with_natural_pose(rotations: Float[Tensor, "*batch 22 3 3"]) -> Float[Tensor, "*batch 22 3 3"]:
    """Keep the root rotations, and set all other joints to the natural pose."""
    pose = natural_pose().to(rotations).expand(*rotations.shape[:-3], 21, 3, 3)
    return torch.cat((rotations[..., :1, :, :], pose), -3)


@dataclass(frozen=True)
class PoseEnergies(TiedFrames[Poses]):
    """Energies of the poses of a body of known shape, frame by frame, and ties between frames.

    Of markers, ½ Σ kernel(|p - m|²); of the distance from the natural pose, Σ (1 - cos angle); of
    soles below the ground, half their mean squared depth; of ties, Σ (1 - cos angle) by joints.
    """

    rest: Float[Tensor, "22 3"]
    """Joints of the unposed body, metres."""
    markers: SkinPoints
    soles: SkinPoints | None
    """Points under the feet that are held above z = 0; None where the ground is elsewhere."""
    positions: Float[Tensor, "frames 3 markers"]
    """Observed marker positions in the world, metres; zero where not visible."""
    visible: Float[Tensor, "frames markers"]
    """Weight of a marker where it is visible, usually 1; 0 elsewhere."""
    linked: Bool[Tensor, " between"]
    """Whether a frame is tied to the next one."""
    natural: Float[Tensor, "#frames 21 3 3"]
    """Joint rotations of the natural pose: the same in all frames, or one per frame."""
    pull: Float[Tensor, "#frames"]
    """Weight of the distance from the natural pose, one for all frames or one per frame."""
    ground: float
    """Weight of the depth of soles below the ground."""
    turning: Float[Tensor, " 22"]
    """Weights of the joints' rotations from frame to frame, which `weight` does not multiply."""
    weight: float = 1.0
    """Multiplier of the energies of single frames."""
    sigma: float | None = None
    """Scale of Geman and McClure's kernel, metres; None is least squares."""

    @property
    def tie_stiffness(self) -> Float[Tensor, " 69"]:
        """Second derivatives of a tie by the coordinates of a step; zero for translations."""
        return torch.cat((self.turning.new_zeros(3), self.turning.repeat(3)))

    def frames(self, index: Int[Tensor, " frames"]) -> "PoseEnergies":
        """Return the energies of some frames, ascending; neighbouring frames stay tied."""
        apart = (~self.linked).cumsum(0)
        run = pad(apart, (1, 0))[index]
        linked = (index.diff() == 1) & (run.diff() == 0)
        return replace(
            self,
            positions=self.positions[index],
            visible=self.visible[index],
            linked=linked,
            natural=_values_of_rows(self.natural, index),
            pull=_values_of_rows(self.pull, index),
        )

    def untied(self) -> "PoseEnergies":
        """Return the same energies without ties between frames."""
        return replace(self, linked=torch.zeros_like(self.linked))

    def poses_of(
        self, translation: Float[Tensor, "frames 3"], rotations: Float[Tensor, "frames 22 3 3"]
    ) -> Poses:
        """Return the poses of this body, given translations (m) and joint rotations."""
        return Poses.of(translation, rotations, self.rest)

    def energies_and_gradients(
        self, state: Poses, rows: Int[Tensor, " rows"]
    ) -> tuple[Float[Tensor, " rows"], Float[Tensor, "rows 69"]]:
        """Return the energies of some frames, without ties, and their gradients."""
        some = _poses_of_rows(state, rows)
        value, slope, away = self._residuals(some, rows)
        gradient = self.markers.gradient_by_rotations(some, away * slope[:, None])
        value = 0.5 * value.sum(-1)
        drawn = some.rotations[:, 1:]
        natural, pull = _values_of_rows(self.natural, rows), _values_of_rows(self.pull, rows)
        value = value + pull / 4 * (drawn - natural).square().sum((1, 2, 3))
        bent = pad(so3.axis_sine(natural.mT @ drawn), (0, 0, 1, 0))
        gradient[:, 3:] += pull[:, None] * flat_world_vectors(bent, some.orientations)
        if self.soles is not None:
            depth, weight = self.sole_heights(some)
            value = value + 0.5 * (weight * depth.square()).sum(-1)
            gradient = gradient + self.soles.gradient_by_rotations(
                some, pad((weight * depth)[:, None], (0, 0, 2, 0))
            )
        return self.weight * value, self.weight * gradient

    def curvature(self, state: Poses, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows 69 69"]:
        """Return the Gauss-Newton Hessians of the energies of some frames, without ties."""
        some = _poses_of_rows(state, rows)
        _, slope, _ = self._residuals(some, rows)
        out = self.markers.levers.stiffness(some.bones, slope)
        diagonal = out.diagonal(dim1=1, dim2=2)[:, 3:].unflatten(-1, (3, -1))
        diagonal[..., 1:] += _values_of_rows(self.pull, rows)[:, None, None]
        if self.soles is not None:
            _, weight = self.sole_heights(some)
            touching = weight.any(-1).nonzero()[:, 0]
            self.soles.levers.add_height_hessian(
                out, touching, some.bones[touching], weight[touching]
            )
        return self.weight * out

    def can_share_hessian(
        self, some: Int[Tensor, " rows"], others: Int[Tensor, " rows"]
    ) -> Bool[Tensor, " rows"]:
        """Return which pairs of frames show the same markers, so that they can share a Hessian."""
        return (self.visible[some] == self.visible[others]).all(-1)

    def tie_energies(
        self, state: Poses
    ) -> tuple[Float[Tensor, " between"], Float[Tensor, "frames 69"]]:
        """Return the energies of joint rotations from frame to frame, and their gradients."""
        rotations = state.rotations
        gradient = rotations.new_zeros(len(rotations), COORDINATES)
        weight = self.turning * self.linked[:, None]
        if not bool(weight.any()):
            return weight.sum(-1), gradient
        value = (weight / 4 * rotations.diff(dim=0).square().sum((2, 3))).sum(-1)
        bent = weight[..., None] * so3.axis_sine(rotations[:-1].mT @ rotations[1:])
        ends = pad(bent, (0, 0, 0, 0, 1, 1))
        gradient[:, 3:] = flat_world_vectors(ends[:-1] - ends[1:], state.orientations)
        return value, gradient

    def moved(self, state: Poses, rows: Int[Tensor, " rows"], steps: Tensor) -> Poses:
        """Return the poses of all frames, those of `rows` after a step of the solver."""
        found = _poses_of_rows(state, rows).moved(steps, self.rest)
        if len(rows) == len(state.translation):
            return found
        fresh = iter(found.tensors().values())
        return state.map(lambda tensor: tensor.index_copy(0, rows, next(fresh)))

    def forces(
        self, state: Poses
    ) -> tuple[Float[Tensor, "frames 3 markers"], Float[Tensor, "frames markers"]]:
        """Return derivatives of the energies by marker positions, and the residuals' weights."""
        _, slope, away = self._residuals(state, torch.arange(len(state.translation)))
        slope = self.weight * slope
        return away * slope[:, None], slope

    def sole_heights(
        self, state: Poses
    ) -> tuple[Float[Tensor, "frames soles"], Float[Tensor, "frames soles"]]:
        """Return heights of points under the feet, metres, and weights, zero above the ground."""
        assert self.soles is not None
        height = self.soles.places(state)[:, 2]
        return height, (self.ground / height.shape[-1]) * (height < 0).to(height)

    def _residuals(self, some: Poses, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return kernel(|r|²), its derivative, and residuals r, predicted minus observed (m)."""
        away = self.markers.places(some) - _values_of_rows(self.positions, rows)
        seen, size = _values_of_rows(self.visible, rows), away.square().sum(1)
        if self.sigma is None:
            return size * seen, seen, away
        scale = self.sigma**2
        share = scale / (scale + size)
        return share * size * seen, share.square() * seen, away


def _poses_of_rows(state: Poses, rows: Tensor) -> Poses:
    # if all frames are wanted, avoid the copy that indexing makes
    return state if len(rows) == len(state.translation) else state[rows]


def _values_of_rows(values: Tensor, rows: Tensor) -> Tensor:
    # a single row holds for all frames and needs no index
    return values if len(values) in (1, len(rows)) else values[rows]
