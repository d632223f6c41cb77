"""Fits fingers to points of hands, after the body, whose wrists give each hand's place.

A hand has 22 angles per frame, a length of every bone, a rotation of its wrist, and an offset of
the body's wrist from the data's. Points are weighted by their noise; what they do not determine
follows from how hands are at rest, how joints bend together, limits of joints, and smoothness.
Joints of the body are unchanged: a wrist's rotation moves none of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.derivatives import right_jacobian
from recon.body.hands import ANGLES, JOINT_OF_ANGLE, LIMITS, RELAXED, HandModel, PosedHand
from recon.core import rotations as so3
from recon.core.camera import Camera
from recon.core.fingers import FINGERS
from recon.method.protocols import REFERENCE_FPS
from recon.solver.banded import Banded, Factor, add_differences
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise

_TURN, _SHIFT, _ANGLES = slice(0, 3), slice(3, 6), slice(6, 28)
_SIZE, _BONES, _POINTS = 28, 20, 21
_TURN_STD, _SHIFT_STD = np.deg2rad(60.0), 0.002
"""Standard deviations (rad, m) of the wrist of a body that was fitted to other points."""
_LENGTH_STD, _SCALE_STD = 0.06, 0.1
"""Standard deviations of the logarithms of a bone's length and of the hand's size."""
_LIMIT_STD = np.deg2rad(1.0)
"""Angle (rad) beyond a joint's limit that costs as much as a residual of one standard
deviation."""
_ANGLE_CHANGE_STD, _TURN_CHANGE_STD, _SHIFT_CHANGE_STD = np.deg2rad(2.5), np.deg2rad(2.5), 0.001
"""Standard deviations of second differences at 30 Hz: finger angles (rad), wrist rotation (rad)
and offset (m)."""
_POSES_PER_S = 3.0
"""Number of independent poses per second: poses change little within a third of a second."""
_ROBUST_STDS = 4.0
"""Residual, in standard deviations, beyond which a point counts ever less (Geman and McClure)."""
_OPTIONS = GaussNewton(max_iterations=25, tolerance=1e-4)


@dataclass(frozen=True)
class HandView:
    """Points of one hand that one sensor saw, in the frames of the motion, and their noise."""

    values: Float[Tensor, "time 21 dims"]
    """World positions (m), or pixels of a camera; zero where not seen."""
    weights: Float[Tensor, "time 21"]
    """Confidence over the standard deviation of a coordinate; zero where not seen."""
    camera: Camera | None = None
    """Camera in the world, with one pose or one per frame; None for points in space."""


@dataclass(frozen=True)
class FittedHand:
    """Angles, wrist rotation, bone lengths and uncertainty of one fitted hand."""

    angles: Float[Tensor, "time 22"]
    wrist: Float[Tensor, "time 3 3"]
    """World rotation of the wrist."""
    lengths: Float[Tensor, " 20"]
    tip_std: Float[Tensor, "time 5"]
    """Largest standard deviation (m) of every tip relative to the wrist, over all directions."""
    local: Float[Tensor, "time 15 3 3"]


def fit_hand(
    views: Sequence[HandView],
    model: HandModel,
    side: int,
    wrist_rotation: Float[Tensor, "time 3 3"],
    wrist_position: Float[Tensor, "time 3"],
    fps: float,
) -> FittedHand:
    """Fit angles, wrist and bone lengths of one hand to the points that all sensors saw.

    Args:
        views: points by sensor, with the same frames as the wrist; at least one.
        model: model of the person's hands.
        side: 0 for the left hand, 1 for the right.
        wrist_rotation: world rotation of the body's wrist.
        wrist_position: world position (m) of the wrist.
        fps: frames per second.
    """
    share = min(1.0, _POSES_PER_S / fps)
    base = wrist_rotation.double() @ _mean_turn_to_palm(
        views, model, side, wrist_rotation.double()
    )
    problem = _FingerProblem(
        tuple(views), model, side, base, wrist_position.double(), fps, _angle_precision() * share,
        _TURN_STD * share**-0.5, _SHIFT_STD * share**-0.5,
    )  # fmt: skip
    x = torch.zeros(len(base) * _SIZE + _BONES, dtype=torch.float64)
    frames = x[:-_BONES].view(len(base), _SIZE)
    frames[:, _ANGLES] = RELAXED
    x, _ = minimise(problem, x[None], _OPTIONS)
    frames, lengths = problem.split_variables(x)
    posed = problem.posed(x)
    return FittedHand(
        frames[:, _ANGLES], so3.exp(frames[:, _TURN]) @ base, problem.bone_lengths(lengths),
        problem.tip_std(x), posed.local,
    )  # fmt: skip


def _angle_precision() -> Float[Tensor, "22 22"]:
    """Return the inverse covariance (1 / rad²) of finger angles about the relaxed hand.

    The outer joint of a finger bends two thirds of the middle one (Rijpkema and Girard 1991), and
    neighbouring fingers bend together: so few directions hold most of how hands grasp, as in
    recordings (Santello et al. 1998).
    """
    number = {name: k for k, name in enumerate(ANGLES)}
    rows, stds = [], []

    def add_expectation(std: float, **shares: float) -> None:
        row = np.zeros(len(ANGLES))
        for name, share in shares.items():
            row[number[name]] = share
        rows.append(row)
        stds.append(np.deg2rad(std))

    for name in ANGLES:
        add_expectation(40.0 if name.endswith("flexion") else 15.0, **{name: 1.0})
    outer = FINGERS[1:]
    for finger in outer:
        add_expectation(12.0, **{f"{finger}_dip_flexion": 1.0, f"{finger}_pip_flexion": -2 / 3})
    for one, other in pairwise(outer):
        for joint in ("mcp", "pip"):
            add_expectation(
                35.0, **{f"{one}_{joint}_flexion": 1.0, f"{other}_{joint}_flexion": -1.0}
            )
        add_expectation(10.0, **{f"{one}_mcp_abduction": 1.0, f"{other}_mcp_abduction": -1.0})
    scaled = np.stack(rows) / np.array(stds)[:, None]
    return torch.from_numpy(scaled.T @ scaled)


def _mean_turn_to_palm(
    views: Sequence[HandView], model: HandModel, side: int, wrist: Float[Tensor, "time 3 3"]
) -> Float[Tensor, "3 3"]:
    """Return the mean rotation from the body's wrist to the palm, as measured by 3D points."""
    palm_points = [0, 5, 9, 13, 17]
    total = torch.eye(3, dtype=torch.float64) * 1e-3
    bones = (model.directions[side] * model.lengths[side, :, None])[[4, 8, 12, 16]]
    flat = torch.cat((bones.new_zeros(1, 3), bones))
    for view in views:
        if view.camera is not None:
            continue
        seen = (view.weights[:, palm_points] > 0).to(flat)
        there = seen.sum(-1) >= 3
        if not bool(there.any()):
            continue
        seen, points = seen[there], view.values[there][:, palm_points].to(flat)
        share = (seen / seen.sum(-1, keepdim=True))[..., None]
        a, b = flat - (share * flat).sum(-2, keepdim=True), points - (share * points).sum(-2, True)
        matched = (share * b).mT @ a
        turn = so3.nearest_rotation(matched + 1e-9 * wrist[there])
        total = total + (wrist[there].mT @ turn).sum(0)
    return so3.nearest_rotation(total)


@dataclass(frozen=True)
class _FingerProblem(Problem[Tensor]):
    """Least squares for one hand: 28 variables per frame, and logarithms of bone lengths."""

    views: tuple[HandView, ...]
    model_of_hand: HandModel
    side: int
    base: Float[Tensor, "time 3 3"]
    place: Float[Tensor, "time 3"]
    fps: float
    precision: Float[Tensor, "22 22"]
    turn_std: float
    shift_std: float

    def split_variables(self, x: Tensor) -> tuple[Float[Tensor, "time 28"], Float[Tensor, " 20"]]:
        return x[0, :-_BONES].view(-1, _SIZE), x[0, -_BONES:]

    def bone_lengths(self, logarithms: Float[Tensor, " 20"]) -> Float[Tensor, " 20"]:
        return self.model_of_hand.lengths[self.side] * logarithms.exp()

    def posed(self, x: Tensor) -> PosedHand:
        frames, lengths = self.split_variables(x)
        wrist = so3.exp(frames[:, _TURN]) @ self.base
        return self.model_of_hand.posed(
            frames[:, _ANGLES], wrist, self.place, self.side, self.bone_lengths(lengths)
        )

    def points(self, posed: PosedHand, offset: Tensor) -> Float[Tensor, "time 21 3"]:
        return torch.cat((self.place[:, None], posed.points), 1) + offset[:, None]

    def jacobian(self, x: Tensor, posed: PosedHand) -> Float[Tensor, "time 21 3 48"]:
        """Differentiate the points by a frame's variables and by the logarithms of lengths."""
        frames, lengths = self.split_variables(x)
        out = frames.new_zeros(len(frames), _POINTS, 3, _SIZE + _BONES)
        arm = posed.points - self.place[:, None]
        # a change dω turns the hand by J dω, J the left Jacobian at ω (the right one at -ω)
        out[:, 1:, :, _TURN] = -so3.hat(arm) @ right_jacobian(-frames[:, _TURN])[:, None]
        out[:, :, :, _SHIFT] = torch.eye(3).to(out)
        lever = posed.points[:, :, None] - posed.pivots[:, None]
        moved = torch.linalg.cross(posed.axes[:, None].expand_as(lever), lever, dim=-1)
        out[:, 1:, :, _ANGLES] = (moved * _MOVED_POINTS[..., None]).mT
        stretched = posed.ways * self.bone_lengths(lengths)[:, None]
        out[:, 1:, :, _SIZE:] = (stretched[:, None] * _BONES_BEFORE[..., None]).mT
        return out

    def model(self, x: Tensor, rows: Int[Tensor, " rows"]) -> Quadratic:
        del rows
        frames, lengths = self.split_variables(x)
        posed = self.posed(x)
        jacobian = self.jacobian(x, posed)
        curvature = frames.new_zeros(len(frames), _SIZE + _BONES, _SIZE + _BONES)
        slope = frames.new_zeros(len(frames), _SIZE + _BONES)
        for view in self.views:
            away, bent = _residuals(view, self.points(posed, frames[:, _SHIFT]), jacobian)
            size = away.square().sum(-1)
            counts = (_ROBUST_STDS**2 / (_ROBUST_STDS**2 + size)).square()[..., None]
            curvature += torch.einsum("tpdi,tpd,tpdj->tij", bent, counts.expand_as(away), bent)
            slope += torch.einsum("tpdi,tpd->ti", bent, counts * away)
        about, diagonal = self._prior_derivatives(frames)
        curvature[:, :_SIZE, :_SIZE] += diagonal
        slope[:, :_SIZE] += about
        hessian = Banded.zero(len(frames), 2, _SIZE, _BONES, frames)
        hessian.add_frames(torch.arange(len(frames)), curvature)
        stiff = self._smoothness_weights()
        bands = frames.new_zeros(len(frames), 3, _SIZE)
        add_differences(bands, (1.0, -2.0, 1.0), stiff.expand(len(frames), _SIZE)[2:])
        eye = torch.eye(_SIZE).to(frames).expand(len(frames), _SIZE, _SIZE)
        hessian.add_products(bands, eye, eye[..., :0])
        precision = _length_precision()
        hessian.corner.add_(precision)
        bend = frames.diff(n=2, dim=0) * stiff
        slope[:, :_SIZE] += _transposed_differences(bend, len(frames))
        gradient = torch.cat(
            (slope[:, :_SIZE].flatten(), slope[:, _SIZE:].sum(0) + precision @ lengths)
        )
        return Quadratic(self._weighted_residuals(x, posed)[None], gradient[None], [hessian])

    def moved(self, x: Tensor, rows: Int[Tensor, " rows"], steps: Tensor) -> Tensor:
        del rows
        return x + steps.clamp(-0.6, 0.6)

    def value(self, x: Tensor, rows: Int[Tensor, " rows"]) -> Tensor:
        del rows
        return self._weighted_residuals(x, self.posed(x))[None]

    def tip_std(self, x: Tensor) -> Float[Tensor, "time 5"]:
        """Return each tip's worst-direction standard deviation (m) relative to the wrist."""
        quadratic = self.model(x, torch.zeros(1, dtype=torch.long))
        inverse = Factor(quadratic.hessian[0], 0.0).inverse()
        tips = self.jacobian(x, self.posed(x))[:, 4::4]
        own, sizes = tips[..., :_SIZE].clone(), tips[..., _SIZE:]
        own[..., _SHIFT] = 0
        via = sizes - own @ inverse.onto[:, None]
        spread = own @ inverse.within[:, None] @ own.mT + via @ inverse.border @ via.mT
        return torch.linalg.eigvalsh(spread)[..., -1].clamp(min=0).sqrt()

    def _weighted_residuals(self, x: Tensor, posed: PosedHand) -> Float[Tensor, " terms"]:
        frames, lengths = self.split_variables(x)
        points = self.points(posed, frames[:, _SHIFT])
        data = points.new_zeros(())
        for view in self.views:
            size = _residuals(view, points, None)[0].square().sum(-1)
            data = data + 0.5 * (_ROBUST_STDS**2 * size / (_ROBUST_STDS**2 + size)).sum()
        off, beyond = frames[:, _ANGLES] - RELAXED, _excess_over_limits(frames[:, _ANGLES])
        bend = frames.diff(n=2, dim=0)
        usual = 0.5 * (off * (off @ self.precision)).sum()
        wrist = (frames[:, _TURN] / self.turn_std).square().sum()
        wrist = wrist + (frames[:, _SHIFT] / self.shift_std).square().sum()
        limits = 0.5 * (beyond / _LIMIT_STD).square().sum()
        smooth = 0.5 * (self._smoothness_weights() * bend.square()).sum()
        sizes = 0.5 * lengths @ _length_precision() @ lengths
        return torch.stack((data, usual + limits, 0.5 * wrist, smooth, sizes))

    def _prior_derivatives(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Return gradient and Hessian of the prior energy of every frame's variables."""
        gradient, hessian = torch.zeros_like(frames), frames.new_zeros(len(frames), _SIZE, _SIZE)
        bends, beyond = frames[:, _ANGLES], _excess_over_limits(frames[:, _ANGLES])
        gradient[:, _ANGLES] = (bends - RELAXED) @ self.precision + beyond / _LIMIT_STD**2
        hessian[:, _ANGLES, _ANGLES] = self.precision
        hessian[:, _ANGLES, _ANGLES] += torch.diag_embed((beyond != 0) / _LIMIT_STD**2)
        for part, std in ((_TURN, self.turn_std), (_SHIFT, self.shift_std)):
            gradient[:, part] = frames[:, part] / std**2
            hessian[:, part, part] += torch.eye(3).to(frames) / std**2
        return gradient, hessian

    def _smoothness_weights(self) -> Float[Tensor, " 28"]:
        """Return the inverse variance of second differences at the frame rate, per variable."""
        std = self.base.new_full((_SIZE,), _ANGLE_CHANGE_STD)
        std[_TURN], std[_SHIFT] = _TURN_CHANGE_STD, _SHIFT_CHANGE_STD
        return (std * (REFERENCE_FPS / self.fps) ** 2).square().reciprocal()


def _residuals(
    view: HandView, points: Float[Tensor, "time 21 3"], jacobian: Tensor | None
) -> tuple[Tensor, Tensor | None]:
    """Return predicted minus seen values over their noise, and their derivatives."""
    weights = view.weights.to(points)[..., None]
    if view.camera is None:
        derivatives = None if jacobian is None else weights[..., None] * jacobian
        return weights * (points - view.values.to(points)), derivatives
    camera = view.camera
    in_camera = camera.to_camera(points)
    depth = in_camera[..., 2:].clamp(min=0.05)
    rays, matrix = in_camera[..., :2] / depth, camera.camera_matrix.to(points)
    pixels = rays @ matrix[..., :2, :2].mT + matrix[..., None, :2, 2]
    derivatives = None
    if jacobian is not None:
        eye = torch.eye(2).to(points).expand(*rays.shape, 2)
        inward = matrix[..., None, :2, :2] @ (
            torch.cat((eye, -rays[..., None]), -1) / depth[..., None]
        )
        turn = camera.T_camera_world.to(points)[..., None, :3, :3]
        derivatives = weights[..., None] * (inward @ turn @ jacobian)
    return weights * (pixels - view.values.to(points)), derivatives


def _excess_over_limits(bends: Float[Tensor, "time 22"]) -> Float[Tensor, "time 22"]:
    """Return by how much angles (rad) exceed their limits; negative below the lower limit."""
    return bends - bends.clamp(LIMITS[:, 0], LIMITS[:, 1])


def _length_precision() -> Float[Tensor, "20 20"]:
    own = torch.eye(_BONES, dtype=torch.float64) * _LENGTH_STD**2
    return torch.linalg.inv(own + _SCALE_STD**2)


def _transposed_differences(
    differences: Float[Tensor, "steps n"], frames: int
) -> Float[Tensor, "time n"]:
    """Apply the transpose of the operator that takes second differences over time."""
    out = differences.new_zeros(frames, differences.shape[-1])
    for k, share in enumerate((1.0, -2.0, 1.0)):
        out[k : k + len(differences)] += share * differences
    return out


def _dependence_masks() -> tuple[Bool[Tensor, "20 22"], Bool[Tensor, "20 20"]]:
    """Return masks of the points that each angle moves, and of the bones before each point."""
    point = torch.arange(_BONES)
    finger, place = point // 4, point % 4
    joint = torch.tensor(JOINT_OF_ANGLE)
    moves = (finger[:, None] == joint // 3) & (place[:, None] > joint % 3)
    return moves, (finger[:, None] == finger) & (place[:, None] >= place)


_MOVED_POINTS, _BONES_BEFORE = _dependence_masks()
