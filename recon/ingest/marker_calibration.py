"""Calibrates a body to its markers: shape, marker offsets, and the poses of some frames."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.struct import TensorStruct
from recon.ingest.marker_poses import PoseEnergies, Poses, SkinPoints
from recon.ingest.tied_frames import LevenbergMarquardt, minimise_frames
from recon.solver.banded import Banded
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise

_EVERY = 4
"""Step between the frames from which shape and offsets are first found, before all are used."""
_ROUGH = 0.1
"""Relative decrease of an energy that ends a fit whose result only begins another fit."""
_NEAR = 1e-2
_TOLERANCE = 1e-3
_DAMPING = 1e-2
"""Damping of the first steps, which start from a pose that is far from that of the markers."""


@dataclass(frozen=True)
class CalibratedFrames(TensorStruct):
    """Poses of some frames of one person, and the shape and marker offsets common to all."""

    poses: Poses
    shape: Float[Tensor, " shape"]
    offsets: Float[Tensor, "markers 3"]
    """Offsets of the markers from their vertices, in the frames of their bones, metres."""


@dataclass(frozen=True)
class SubjectEnergies(Problem[CalibratedFrames]):
    """The energy of a person's markers as a function of poses, shape and marker offsets.

    It is the sum of `PoseEnergies`, and per frame the squared length of the shape and half of
    the squared distances of offsets from expected ones, each with a weight.
    """

    body: BodyModel
    vertices: Int[Tensor, " markers"]
    under: Int[Tensor, " soles"] | None
    """Vertices under the feet; None where the ground is not at z = 0."""
    nominal: Float[Tensor, "markers 3"]
    """Expected offsets of markers from their vertices, metres."""
    stiffness: Float[Tensor, " markers"]
    """Weight of the distance of each marker's offset from the expected one, per frame."""
    stature: float
    """Weight of the squared shape coefficients, per frame."""
    poses: PoseEnergies
    """Energies of the poses, without ties; rest joints and skin points are replaced by those of
    the present shape, and the weight of each frame is 1."""
    with_offsets: bool
    """Whether marker offsets are optimised, too; the shape always is."""

    def for_body(self, shape: Tensor, offsets: Tensor) -> PoseEnergies:
        """Return the energies of poses for a known shape and known marker offsets."""
        under = self.under
        return replace(
            self.poses,
            rest=self.body.rest_joints(shape),
            markers=SkinPoints.of(self.body, shape, self.vertices, offsets),
            soles=None if under is None else SkinPoints.of(self.body, shape, under),
        )

    def frames(self, index: Int[Tensor, " frames"]) -> "SubjectEnergies":
        """Return the same energies restricted to some of the frames."""
        return replace(self, poses=self.poses.frames(index))

    def value(self, x: CalibratedFrames, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows 1"]:
        """Return the total energy of poses, shape and marker offsets."""
        value, _ = self.for_body(x.shape, x.offsets).energies_and_gradients(x.poses, self._frames)
        return self._total_energy(x, value).expand(len(rows), 1)

    def _total_energy(
        self, x: CalibratedFrames, value: Float[Tensor, " frames"]
    ) -> Float[Tensor, ""]:
        away = (x.offsets - self.nominal).square().sum(-1)
        common = self.stature * x.shape.square().sum() + 0.5 * self.stiffness @ away
        return value.double().sum() + len(value) * common.double()

    def moved(
        self, x: CalibratedFrames, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> CalibratedFrames:
        """Return poses, shape and marker offsets after one step of the optimiser."""
        del rows
        count, poses, offsets = len(x.shape), len(self._frames), x.offsets
        moved = 3 * len(offsets) if self.with_offsets else 0
        own, by_shape, by_offsets = steps[0].split((steps.shape[1] - count - moved, count, moved))
        shape = x.shape + by_shape
        if self.with_offsets:
            offsets = offsets + by_offsets.unflatten(-1, (-1, 3))
        rest = self.body.rest_joints(shape)
        return CalibratedFrames(x.poses.moved(own.view(poses, -1), rest), shape, offsets)

    def model(self, x: CalibratedFrames, rows: Int[Tensor, " rows"]) -> Quadratic:
        """Return the Gauss-Newton model: one block per pose, bordered by shape and offsets."""
        energies, poses = self.for_body(x.shape, x.offsets), x.poses
        value, gradient = energies.energies_and_gradients(poses, self._frames)
        force, weight = energies.forces(poses)
        jacobian = energies.markers.levers.jacobian(poses.bones)
        by_shape = energies.markers.jacobian_by_shape(poses, self.body)
        weighted = (by_shape * weight[..., None, None]).flatten(1, 2)
        border = jacobian.flatten(1, 2).mT @ weighted
        frames = len(value)
        count = frames * self.stature
        corner = (by_shape.flatten(1, 2).mT @ weighted).sum(0)
        corner.diagonal().add_(2 * count)
        slope = torch.einsum("tvdk,tdv->k", by_shape, force) + 2 * count * x.shape
        if energies.soles is not None:
            depth, pressed = energies.sole_heights(poses)
            lift = energies.soles.jacobian_by_shape(poses, self.body)[..., 2, :]
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
            beside = torch.einsum("tvdk,tvde->kve", by_shape, weighted).flatten(1)
            stiffness = frames * self.stiffness
            own = (weight.sum(0) + stiffness).repeat_interleave(3).diag()
            corner = torch.cat((torch.cat((corner, beside), 1), torch.cat((beside.mT, own), 1)))
            away = stiffness[:, None] * (x.offsets - self.nominal)
            drawn = torch.einsum("tvde,tdv->ve", turns, force) + away
            slope = torch.cat((slope, drawn.flatten()))
        inner = energies.curvature(poses, self._frames)[:, None]
        return Quadratic(
            self._total_energy(x, value).expand(len(rows), 1),
            torch.cat((gradient.flatten(), slope))[None],
            [Banded(inner, border, corner)],
        )

    @property
    def _frames(self) -> Int[Tensor, " frames"]:
        return torch.arange(len(self.poses.visible))


def calibrated_frames(
    energies: SubjectEnergies,
    translation: Float[Tensor, "frames 3"],
    rotations: Float[Tensor, "frames 22 3 3"],
    sigma: float,
) -> CalibratedFrames:
    """Find poses, shape and marker offsets, starting at rough poses of the average body.

    Args:
        energies: energies of all frames.
        translation: root positions of the rough poses, metres.
        rotations: joint rotations of the rough poses.
        sigma: scale of Geman and McClure's kernel, metres. The first fits are without the kernel,
            since markers far from a rough pose are no outliers.
    """
    shape = energies.body.joint_directions.new_zeros(energies.body.shape_size)
    plain = replace(energies, poses=replace(energies.poses, sigma=None), with_offsets=False)
    robust = replace(energies, poses=replace(energies.poses, sigma=sigma), with_offsets=True)
    average = plain.for_body(shape, energies.nominal)
    rough = LevenbergMarquardt(tolerance=_ROUGH, damping=_DAMPING)
    poses = minimise_frames(average, average.poses_of(translation, rotations), rough).state
    few = torch.arange(0, len(translation), _EVERY)
    state = CalibratedFrames(poses[few], shape, energies.nominal)
    state, _ = minimise(plain.frames(few), state, GaussNewton(20, _ROUGH, damping=0.0))
    state, _ = minimise(robust.frames(few), state, GaussNewton(50, _NEAR, damping=0.0))
    of_subject = robust.for_body(state.shape, state.offsets)
    start = of_subject.poses_of(poses.translation, poses.rotations)
    poses = minimise_frames(of_subject, start, LevenbergMarquardt(tolerance=_NEAR)).state
    state = CalibratedFrames(poses, state.shape, state.offsets)
    return minimise(robust, state, GaussNewton(50, _TOLERANCE, damping=0.0))[0]
