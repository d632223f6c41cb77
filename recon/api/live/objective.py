"""The energies of a window under the pose prior, and their Gauss-Newton equations.

They are those of `priors.pose.prior.PosePrior` as a method: data, the density of poses, small
second differences of the joints' paths.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from observations.together.moments import Tracker
from observations.together.quadratic import energy_of
from priors.pose.density import PoseDensity
from priors.pose.prior import PoseWeights
from recon.api.live.window import VARIABLES, Window
from recon.body.derivatives import CarriedPoints, turned_by
from recon.body.kinematics import forward_kinematics
from recon.body.model import BodyModel
from recon.method.protocols import REFERENCE_FPS
from recon.solver.chain import Chain


@dataclass(frozen=True)
class Equations:
    """Second-order model of a window's energies about where it is.

    E + gᵀ dx + hᵀ db + ½ (dxᵀ A dx + 2 dxᵀ G db + dbᵀ C db), with dx the steps of the active
    frames and db that of the shape.
    """

    value: float
    gradient: Float[Tensor, "active 69"]
    blocks: Float[Tensor, "active 69 69"]
    """Blocks of A on its diagonal, those of `alone` included."""
    next: Float[Tensor, "between 69 69"]
    """Blocks of A between frames t and t + 1."""
    after_next: Float[Tensor, "across 69 69"]
    """Blocks of A between frames t and t + 2."""
    alone: Float[Tensor, "active 69 69"]
    """What data and pose of every frame alone give to A."""
    gradient_alone: Float[Tensor, "active 69"]
    border: Float[Tensor, "active 69 shape"]
    """G."""
    corner: Float[Tensor, "active shape shape"]
    """C, frame by frame."""
    gradient_shape: Float[Tensor, "active shape"]
    """h, frame by frame."""

    def chain(self, damping: float) -> Chain:
        """The equations of a damped step, two frames to a block.

        An odd number of frames has one more before the first, which nothing holds or moves.
        """
        n, odd = VARIABLES, len(self.blocks) % 2
        ahead = (0, 0, 0, 0, odd, 0)
        grown = self.blocks + damping * torch.diag_embed(self.alone.diagonal(dim1=1, dim2=2))
        grown = torch.cat((torch.eye(n).to(grown)[None][:odd], grown))
        near, far = pad(self.next, ahead), pad(self.after_next, ahead)
        first, second = slice(0, None, 2), slice(1, None, 2)
        diagonal = grown.new_zeros(len(grown) // 2, 2 * n, 2 * n)
        diagonal[:, :n, :n], diagonal[:, n:, n:] = grown[first], grown[second]
        diagonal[:, :n, n:], diagonal[:, n:, :n] = near[first], near[first].mT
        upper = grown.new_zeros(len(diagonal) - 1, 2 * n, 2 * n)
        upper[:, :n, :n], upper[:, n:, n:] = far[first], far[second]
        upper[:, n:, :n] = near[second]
        return Chain(
            diagonal=diagonal,
            upper=upper,
            border=pad(self.border, ahead).reshape(len(diagonal), 2 * n, -1),
            corner=self.corner.sum(0),
            right=-pad(self.gradient, (0, 0, odd, 0)).reshape(-1, 2 * n),
            right_border=-self.gradient_shape.sum(0),
        )


@dataclass(frozen=True)
class Objective:
    """What does not change while a window is moved."""

    body: BodyModel
    density: PoseDensity
    weights: PoseWeights
    scales: tuple[float, ...]
    """Weight of every sensor's energy."""
    points: tuple[CarriedPoints, ...]
    """The points of every sensor."""
    joints: CarriedPoints
    shape: Float[Tensor, " shape"]
    rest: Float[Tensor, "22 3"]
    """Joints of the unposed body of this shape, metres."""
    fps: float
    offsets: Float[Tensor, "rows 3"]
    """Constant offsets of points from their place on the model; see `Scene.offsets`."""

    @property
    def rate(self) -> float:
        """Multiplier of sums over frames, which weights take at 30 Hz."""
        return REFERENCE_FPS / self.fps

    @property
    def stiffness(self) -> float:
        """Weight of ½ |second difference|² at the rate of the window."""
        return self.weights.acceleration / self.rate**3

    def posed(self, window: Window) -> tuple[Tensor, Tensor, Tensor]:
        """Rotations, orientations and joints of all frames."""
        rotations = window.rotations(self.density)
        orientations, joints = forward_kinematics(rotations, self.rest)
        return rotations, orientations, joints + window.translation[:, None]

    def value(self, window: Window, seen: Sequence[Tracker]) -> float:
        """The energy of a window whose last frames have data."""
        _, orientations, joints = self.posed(window)
        held = window.frames - seen[0].moments
        total = self.weights.pose * self.rate * window.pose[held:].square().sum()
        bend = joints.diff(n=2, dim=0)[max(held - 2, 0) :]
        total = total + 0.5 * self.stiffness * bend.square().sum()
        for scale, points, sensor in zip(self.scales, self.points, seen, strict=True):
            places = points.of(orientations[held:], joints[held:])
            total = total + scale * energy_of(sensor, places)
        return float(total)

    def equations(self, window: Window, seen: Sequence[Tracker], with_shape: bool) -> Equations:
        """The model of the last frames, those with data; earlier ones are held where they are."""
        rotations, orientations, joints = self.posed(window)
        held, active = window.frames - seen[0].moments, seen[0].moments
        pose = window.pose[held:]
        steps = (pose @ self.density.basis.mT).unflatten(-1, (-1, 3))
        turns = (turned_by(steps) @ self.density.basis.unflatten(0, (-1, 3))).flatten(1, 2)
        own = orientations[held:], joints[held:]
        weight = self.weights.pose * self.rate
        count = len(self.shape) if with_shape else 0
        value = weight * pose.square().sum()
        gradient = pad(2 * weight * pose, (6, 0))
        alone = torch.diag_embed(pad(pose.new_full(pose.shape, 2 * weight), (6, 0)))
        border = pose.new_zeros(active, VARIABLES, count)
        corner = pose.new_zeros(active, count, count)
        gradient_shape = pose.new_zeros(active, count)
        for scale, points, sensor in zip(self.scales, self.points, seen, strict=True):
            model = sensor.point_model(points.of(*own))
            jacobian = _by_variables(points.by_rotations(*own), turns)
            pulled = (scale * model.curvature @ jacobian).flatten(1, 2)
            columns = jacobian.flatten(1, 2)
            down = scale * model.gradient.flatten(1)[:, None]
            value = value + scale * model.value
            gradient = gradient + (down @ columns)[:, 0]
            alone = alone + columns.mT @ pulled
            if with_shape:
                by_shape = points.by_shape(rotations[held:], own[0], self.body).flatten(1, 2)
                border = border + pulled.mT @ by_shape
                flat = (scale * model.curvature @ by_shape.unflatten(1, (-1, 3))).flatten(1, 2)
                corner = corner + by_shape.mT @ flat
                gradient_shape = gradient_shape + (down @ by_shape)[:, 0]
        bend = joints.diff(n=2, dim=0)[max(held - 2, 0) :]
        second = _second_differences(window.frames, held).to(bend)
        column = _by_variables(self.joints.by_rotations(*own), turns).flatten(1, 2)
        force = self.stiffness * (second[:, held:].mT @ bend.flatten(1))
        smooth = self.stiffness * (second.mT @ second)[held:, held:]
        value = value + 0.5 * self.stiffness * bend.square().sum()
        between = [
            smooth.diagonal(k)[:, None, None] * (column[: active - k].mT @ column[k:])
            for k in range(3)
        ]
        return Equations(
            value=float(value),
            gradient=gradient + (force[:, None] @ column)[:, 0],
            blocks=alone + between[0],
            next=between[1],
            after_next=between[2],
            alone=alone,
            gradient_alone=gradient,
            border=border,
            corner=corner,
            gradient_shape=gradient_shape,
        )


def _by_variables(
    jacobian: Float[Tensor, "time points 3 66"], turns: Float[Tensor, "time 63 63"]
) -> Float[Tensor, "time points 3 69"]:
    """Derivatives by the variables of a window from those by steps of the joints' rotations."""
    moved = torch.eye(3).to(jacobian).expand(*jacobian.shape[:2], 3, 3)
    posed = (jacobian[..., 3:].flatten(1, 2) @ turns).unflatten(1, (-1, 3))
    return torch.cat((moved, jacobian[..., :3], posed), -1)


def _second_differences(frames: int, held: int) -> Float[Tensor, "rows frames"]:
    """Rows p_(t+1) - 2 p_t + p_(t-1) that a frame that is not held takes part in."""
    return torch.eye(frames).diff(n=2, dim=0)[max(held - 2, 0) :]
