"""The objective of a stream's window of frames, and its Gauss-Newton equations.

The energies are those of fits under `priors.pose.prior.PosePrior`: data, the density of poses,
and second differences of the joints' paths. A prior of motion adds its energies of the steps
between frames (`StepEnergies`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from observations.moments import Tracker
from priors.pose.prior import PoseDensity, PoseWeights
from recon.body.derivatives import BonePoints
from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS
from recon.method.quadratic import FRAME, jacobian_by_steps
from recon.solver.banded import Banded, add_differences


@dataclass(frozen=True)
class Window(TensorStruct):
    """The variables of a window of motion: translations, root rotations and pose coordinates."""

    translation: Float[Tensor, "time 3"]
    """SMPL translation, metres."""
    root: Float[Tensor, "time 3 3"]
    """Rotation of the root in the world."""
    pose: Float[Tensor, "time 63"]
    """Coordinates z of `PoseDensity`."""

    @classmethod
    def of(
        cls,
        translation: Float[Tensor, "time 3"],
        rotations: Float[Tensor, "time 22 3 3"],
        density: PoseDensity,
    ) -> "Window":
        """Return the variables that represent the given motion exactly."""
        return cls(translation, rotations[:, 0], density.coordinates(rotations[:, 1:]))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.translation)

    def rotations(self, density: PoseDensity) -> Float[Tensor, "time 22 3 3"]:
        """Rotations of all joints relative to their parents."""
        return torch.cat((self.root[:, None], density.rotations(self.pose)), 1)

    def moved(self, steps: Float[Tensor, "active 69"]) -> "Window":
        """Return the window after steps of its last frames' variables; the root is R Exp(step)."""
        place, turn, pose = steps.split((3, 3, FRAME - 6), -1)
        held = self.frames - len(steps)
        return Window(
            torch.cat((self.translation[:held], self.translation[held:] + place)),
            torch.cat((self.root[:held], self.root[held:] @ so3.exp(turn))),
            torch.cat((self.pose[:held], self.pose[held:] + pose)),
        )

    def joined(self, after: "Window") -> "Window":
        """Return the frames of this window followed by those of another."""
        return Window(
            torch.cat((self.translation, after.translation)),
            torch.cat((self.root, after.root)),
            torch.cat((self.pose, after.pose)),
        )

    def extended(self, damping: float) -> "Window":
        """Return the window plus one frame, extrapolated from the last two at damped velocity."""
        before, last = self[-2:-1], self[-1:]
        turn = so3.log(before.root.mT @ last.root)
        new = Window(
            last.translation.lerp(before.translation, -damping),
            last.root @ so3.exp(damping * turn),
            last.pose.lerp(before.pose, -damping),
        )
        return self.joined(new)


_BEND = (1.0, -2.0, 1.0)
"""Second difference of three neighbours."""


@runtime_checkable
class StepEnergies(Protocol):
    """The interface of what a prior's `live(noise)` returns: energies of steps between frames."""

    reach: ClassVar[int]
    """Largest distance, in frames, between two frames of one energy."""

    @property
    def poses(self) -> PoseWeights:
        """Weights of the density of poses and of the joints' accelerations."""
        ...

    def step_energy(self, motion: Motion, joints: Float[Tensor, "1 time 22 3"], held: int) -> Any:
        """Return a record with the differentiable `energy` of the motion's steps."""
        ...

    def add_curvature(
        self,
        motion: Motion,
        evaluated: Any,
        hessian: Banded,
        of_joints: Float[Tensor, "time some 66"],
    ) -> None:
        """Add this energy's Hessian to `hessian` (by variables) and `of_joints` (by positions)."""
        ...


@dataclass(frozen=True)
class Equations:
    """A quadratic model of a window's energy about its current variables.

    E + gᵀ dx + hᵀ db + ½ (dxᵀ A dx + 2 dxᵀ G db + dbᵀ C db), with dx the steps of the active
    frames and db that of the shape.
    """

    value: Float[Tensor, ""]
    gradient: Float[Tensor, "active 69"]
    inner: Float[Tensor, "active reach_and_one 69 69"]
    """Blocks of the Hessian A: [t, k] couples the frames t and t + k; `alone` is included."""
    alone: Float[Tensor, "active 69 69"]
    """Hessian of the terms that depend on one frame alone (data, pose); a part of A."""
    gradient_alone: Float[Tensor, "active 69"]
    border: Float[Tensor, "active 69 shape"]
    """G."""
    corner: Float[Tensor, "active shape shape"]
    """C, frame by frame."""
    gradient_shape: Float[Tensor, "active shape"]
    """h, frame by frame."""


@dataclass(frozen=True)
class Objective:
    """The energy of a window as a function of its variables, with body, weights and priors."""

    body: BodyModel
    density: PoseDensity
    weights: PoseWeights
    scales: tuple[float, ...]
    """Weight of every sensor's energy."""
    points: tuple[BonePoints, ...]
    """The points of every sensor."""
    joints: BonePoints
    shape: Float[Tensor, " shape"]
    rest: Float[Tensor, "22 3"]
    """Joints of the unposed body of this shape, metres."""
    fps: float
    offsets: Float[Tensor, "rows 3"]
    """Constant offsets of points from their place on the model; see `Scene.offsets`."""
    pose_weights: PoseWeights
    """Weights of the density of poses alone; equal to `weights` if `steps` is None."""
    steps: StepEnergies | None = None
    """Energies of a prior beside the density of poses."""

    @property
    def by_poses(self) -> "Objective":
        """The energy under the density of poses alone."""
        return replace(self, weights=self.pose_weights, steps=None)

    @property
    def reach(self) -> int:
        """Number of earlier frames that any energy of a frame depends on; they are held fixed."""
        return len(_BEND) - 1 if self.steps is None else self.steps.reach

    @property
    def scale_to_30_hz(self) -> float:
        """Factor that scales sums over frames to 30 Hz, the rate that weights are for."""
        return REFERENCE_FPS / self.fps

    @property
    def stiffness(self) -> float:
        """Weight of ½ |second difference of a joint|² at the window's frame rate."""
        return self.weights.acceleration / self.scale_to_30_hz**3

    def posed(self, window: Window) -> tuple[Tensor, Tensor, Tensor]:
        """Return the joints' local rotations, world orientations and world positions (metres)."""
        rotations = window.rotations(self.density)
        orientations, joints = forward_kinematics(rotations, self.rest)
        return rotations, orientations, joints + window.translation[:, None]

    def energy(self, window: Window, seen: Sequence[Tracker]) -> float:
        """Return a window's energy; `seen` holds the data of its last frames."""
        rotations, orientations, joints = self.posed(window)
        held = window.frames - seen[0].moments
        total = self.weights.pose * self.scale_to_30_hz * window.pose[held:].square().sum()
        bend = joints.diff(n=2, dim=0)[max(held - 2, 0) :]
        total = total + 0.5 * self.stiffness * bend.square().sum()
        for scale, points, sensor in zip(self.scales, self.points, seen, strict=True):
            places = points.positions(orientations[held:], joints[held:])
            total = total + scale * sensor.energy(places)
        if self.steps is not None:
            motion = self.motion(window, rotations)
            total = total + self.steps.step_energy(motion, joints[None], held).energy
        return float(total)

    def motion(self, window: Window, rotations: Float[Tensor, "time 22 3 3"]) -> Motion:
        """Return a motion of the window's translations and the given rotations, a batch of one."""
        return Motion.create(window.translation[None], rotations[None], self.shape[None], self.fps)

    def equations(self, window: Window, seen: Sequence[Tracker], with_shape: bool) -> Equations:
        """Return the quadratic model in the last frames, which `seen` covers; others are held."""
        rotations, orientations, joints = self.posed(window)
        held = window.frames - seen[0].moments
        pose, own = window.pose[held:], (orientations[held:], joints[held:])
        turns = self.density.turns(pose)
        alone = self._equations_of_single_frames(pose, own, turns, seen, with_shape)
        bend = joints.diff(n=2, dim=0)[max(held - 2, 0) :]
        # rows of differences p_(t+1) - 2 p_t + p_(t-1) that contain a frame that may move
        second = torch.eye(window.frames).to(bend).diff(n=2, dim=0)[max(held - 2, 0) :]
        column = jacobian_by_steps(self.joints.jacobian_by_rotations(*own), turns).flatten(1, 2)
        force = self.stiffness * (second[:, held:].mT @ bend.flatten(1))
        gradient = alone.gradient + (force[:, None] @ column)[:, 0]
        value = alone.value + 0.5 * self.stiffness * bend.square().sum()
        hessian = Banded.zero(window.frames, self.reach, FRAME, 0, pose)
        of_joints = pose.new_zeros(window.frames, self.reach + 1, column.shape[1])
        add_differences(of_joints, _BEND, of_joints.new_tensor([[self.stiffness]]))
        if self.steps is not None:
            evaluated, slope = self._prior_energy_and_gradient(window, held)
            value, gradient = value + evaluated.energy.detach(), gradient + slope
            motion = self.motion(window, rotations)[0]
            self.steps.add_curvature(motion, evaluated, hessian, of_joints)
        inner = replace(hessian, inner=hessian.inner[held:], border=hessian.border[held:])
        inner.add_products(of_joints[held:], column, column[..., :0])
        inner.inner[:, 0] += alone.alone
        return replace(alone, value=value, gradient=gradient, inner=inner.inner)

    def _equations_of_single_frames(
        self,
        pose: Float[Tensor, "active 63"],
        bones: tuple[Float[Tensor, "active 22 3 3"], Float[Tensor, "active 22 3"]],
        turns: Float[Tensor, "active 63 63"],
        seen: Sequence[Tracker],
        with_shape: bool,
    ) -> Equations:
        """Return the quadratic model of the terms of one frame each: data and density of poses.

        Args:
            pose: coordinates of the active frames.
            bones: orientations and joints (metres) there.
            turns: derivatives of joint rotations by `pose`.
            seen: data of these frames.
            with_shape: whether the shape is a variable; if not, it has no columns.
        """
        weight = self.weights.pose * self.scale_to_30_hz
        active, count = len(pose), len(self.shape) if with_shape else 0
        value = weight * pose.square().sum()
        gradient = pad(2 * weight * pose, (6, 0))
        alone = torch.diag_embed(pad(pose.new_full(pose.shape, 2 * weight), (6, 0)))
        border = pose.new_zeros(active, FRAME, count)
        corner = pose.new_zeros(active, count, count)
        gradient_shape = pose.new_zeros(active, count)
        for scale, points, sensor in zip(self.scales, self.points, seen, strict=True):
            model = sensor.point_model(points.positions(*bones))
            jacobian = jacobian_by_steps(points.jacobian_by_rotations(*bones), turns)
            pulled = (scale * model.curvature @ jacobian).flatten(1, 2)
            columns = jacobian.flatten(1, 2)
            down = scale * model.gradient.flatten(1)[:, None]
            value = value + scale * model.value
            gradient = gradient + (down @ columns)[:, 0]
            alone = alone + columns.mT @ pulled
            if with_shape:
                by_shape = points.jacobian_by_shape(bones[0], self.body).flatten(1, 2)
                border = border + pulled.mT @ by_shape
                flat = (scale * model.curvature @ by_shape.unflatten(1, (-1, 3))).flatten(1, 2)
                corner = corner + by_shape.mT @ flat
                gradient_shape = gradient_shape + (down @ by_shape)[:, 0]
        return Equations(
            value, gradient, alone[:, None], alone, gradient, border, corner, gradient_shape
        )

    def _prior_energy_and_gradient(
        self, window: Window, held: int
    ) -> tuple[Any, Float[Tensor, "active 69"]]:
        """Return the prior's energy of steps, and its gradient by the active frames' variables."""
        assert self.steps is not None
        with torch.enable_grad():
            zero = window.pose.new_zeros(window.frames, FRAME, requires_grad=True)
            moved = window.moved(zero)
            rotations, _, joints = self.posed(moved)
            evaluated = self.steps.step_energy(self.motion(moved, rotations), joints[None], held)
            (slope,) = torch.autograd.grad(evaluated.energy, zero)
        return evaluated, slope[held:]
