"""The shape of a body and the offsets of its markers, found with the poses of some frames."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.struct import TensorStruct
from recon.ingest.markers.poses import PoseEnergies, Poses, SkinPoints
from recon.solver.arrow import Arrow, minimise_shared
from recon.solver.levenberg_marquardt import LevenbergMarquardt, minimise_frames

_EVERY = 4
"""Shape and offsets are found from every fourth frame before they are found from all."""
_ROUGH = 0.1
"""Relative decrease of an energy that ends a fit which only begins another."""
_NEAR = 1e-2
_TOLERANCE = 1e-3
_DAMPING = 1e-2
"""Damping of first steps, which begin in another pose than that of the markers."""


@dataclass(frozen=True)
class Calibrated(TensorStruct):
    """Poses of frames, and what they share."""

    poses: Poses
    shape: Float[Tensor, " shape"]
    offsets: Float[Tensor, "markers 3"]
    """Offsets of the markers from their vertices, in the frames of their bones, metres."""


@dataclass(frozen=True)
class SubjectEnergies:
    """Energies of poses, shape and offsets together.

    They are those of `PoseEnergies`, and per frame the squared length of the shape and half of
    the squared distances of offsets from expected ones, each with a weight.
    """

    body: BodyModel
    vertices: Int[Tensor, " markers"]
    under: Int[Tensor, " soles"] | None
    """Vertices under the feet; None where the ground is not at z = 0."""
    nominal: Float[Tensor, "markers 3"]
    """Expected offsets, metres."""
    stiffness: Float[Tensor, " markers"]
    """Weight of every marker's offset, per frame."""
    stature: float
    """Weight of the shape, per frame."""
    poses: PoseEnergies
    """Energies of the poses, without ties; their body and points are replaced by a state's, and
    each of their frames counts 1."""
    with_offsets: bool
    """Whether offsets are moved; the shape always is."""

    def of(self, shape: Tensor, offsets: Tensor) -> PoseEnergies:
        """The energies of the poses of a body with this shape and these offsets."""
        under = self.under
        return replace(
            self.poses,
            rest=self.body.rest_joints(shape),
            markers=SkinPoints.of(self.body, shape, self.vertices, offsets),
            soles=None if under is None else SkinPoints.of(self.body, shape, under),
        )

    def frames(self, index: Int[Tensor, " frames"]) -> "SubjectEnergies":
        """The energies of some frames."""
        return replace(self, poses=self.poses.frames(index))

    def value(self, state: Calibrated) -> Tensor:
        """The whole energy."""
        rows = torch.arange(self._count)
        value, _ = self.of(state.shape, state.offsets).look(state.poses, rows)
        away = (state.offsets - self.nominal).square().sum(-1)
        common = self.stature * state.shape.square().sum() + 0.5 * self.stiffness @ away
        return value.double().sum() + self._count * common.double()

    def moved(self, state: Calibrated, steps: Tensor, common: Tensor) -> Calibrated:
        """The state after steps of the poses, and of the shape and the offsets."""
        count = len(state.shape)
        shape, offsets = state.shape + common[:count], state.offsets
        if self.with_offsets:
            offsets = offsets + common[count:].unflatten(-1, (-1, 3))
        return Calibrated(state.poses.moved(steps, self.body.rest_joints(shape)), shape, offsets)

    def equations(self, state: Calibrated) -> Arrow:
        """LevenbergMarquardt-Newton equations of a step."""
        energies, poses = self.of(state.shape, state.offsets), state.poses
        rows = torch.arange(self._count)
        _, gradient = energies.look(poses, rows)
        force, weight = energies.forces(poses)
        jacobian = energies.markers.levers.jacobian(poses.bones)
        grown = energies.markers.by_shape(poses, self.body)
        weighted = (grown * weight[..., None, None]).flatten(1, 2)
        border = jacobian.flatten(1, 2).mT @ weighted
        count = self._count * self.stature
        corner = (grown.flatten(1, 2).mT @ weighted).sum(0)
        corner.diagonal().add_(2 * count)
        slope = torch.einsum("tvdk,tdv->k", grown, force) + 2 * count * state.shape
        if energies.soles is not None:
            depth, pressed = energies.depths(poses)
            lift = energies.soles.by_shape(poses, self.body)[..., 2, :]
            rising = energies.soles.levers.jacobian(poses.bones)[..., 2, :]
            weighted = lift * pressed[..., None]
            border = border + rising.mT @ weighted
            corner = corner + (lift.mT @ weighted).sum(0)
            slope = slope + torch.einsum("tpk,tp->k", weighted, depth)
        if self.with_offsets:
            bones = self.body.weights[self.vertices].argmax(-1)
            turns = poses.orientations[:, bones]
            weighted = turns * weight[..., None, None]
            moved = (jacobian.mT @ weighted).transpose(1, 2).flatten(2)
            border = torch.cat((border, moved), -1)
            beside = torch.einsum("tvdk,tvde->kve", grown, weighted).flatten(1)
            stiffness = self._count * self.stiffness
            own = (weight.sum(0) + stiffness).repeat_interleave(3).diag()
            corner = torch.cat((torch.cat((corner, beside), 1), torch.cat((beside.mT, own), 1)))
            away = stiffness[:, None] * (state.offsets - self.nominal)
            drawn = torch.einsum("tvde,tdv->ve", turns, force) + away
            slope = torch.cat((slope, drawn.flatten()))
        return Arrow(energies.curvature(poses, rows), border, corner, -gradient, -slope)

    @property
    def _count(self) -> int:
        return len(self.poses.visible)


def calibrated(
    energies: SubjectEnergies,
    translation: Float[Tensor, "frames 3"],
    rotations: Float[Tensor, "frames 22 3 3"],
    sigma: float,
) -> Calibrated:
    """Poses, shape and offsets from rough poses of the average body.

    Args:
        energies: of all frames.
        translation: of the rough poses, metres.
        rotations: of the rough poses.
        sigma: scale of Geman and McClure's kernel, metres. First everything counts alike: a body
            lying in another pose is no outlier.
    """
    shape = energies.body.joint_directions.new_zeros(energies.body.shape_size)
    plain = replace(energies, poses=replace(energies.poses, sigma=None), with_offsets=False)
    robust = replace(energies, poses=replace(energies.poses, sigma=sigma), with_offsets=True)
    average = plain.of(shape, energies.nominal)
    rough = LevenbergMarquardt(tolerance=_ROUGH, damping=_DAMPING)
    poses = minimise_frames(average, average.begun(translation, rotations), rough).state
    few = torch.arange(0, len(translation), _EVERY)
    state = Calibrated(poses[few], shape, energies.nominal)
    state = minimise_shared(plain.frames(few), state, tolerance=_ROUGH, max_iterations=20).state
    state = minimise_shared(robust.frames(few), state, tolerance=_NEAR, max_iterations=50).state
    of_subject = robust.of(state.shape, state.offsets)
    began = of_subject.begun(poses.translation, poses.rotations)
    poses = minimise_frames(of_subject, began, LevenbergMarquardt(tolerance=_NEAR)).state
    state = Calibrated(poses, state.shape, state.offsets)
    return minimise_shared(robust, state, tolerance=_TOLERANCE, max_iterations=50).state
