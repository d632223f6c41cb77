"""Poses of single frames from points whose places on the body are roughly known.

Every point belongs to a bone and has a place on it, so what it asks of a pose is linear in the
pose [O_b | p_b] of that bone. The points of a bone enter by their moments alone (sums of places,
of targets and of their products), and a Gauss-Newton step costs the same for any number of them.
All moments, and all hypotheses about them, step at once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from priors.pose.prior import COORDINATES, ROTATIONS, PoseDensity
from recon.body.derivatives import BELOW, right_jacobian
from recon.body.model import forward_kinematics
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct
from recon.solver.banded import Banded
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise

_BONES = len(JOINTS)
_HANGING = BELOW.nonzero(as_tuple=True)
"""All pairs of a joint and one that is the same or hangs from it."""


def gradient_by_rotations(
    bones: Float[Tensor, "rows 22 3 4"], force: Float[Tensor, "rows 22 3 4"]
) -> tuple[Float[Tensor, "rows 3"], Float[Tensor, "rows 22 3"]]:
    """Gradient of an energy of bone poses by translation and by joint rotations (world axes)."""
    below = BELOW.to(bones)
    moment = force @ bones.mT
    # with M = Σ w r xᵀ over points x and residuals r, the entries of M - Mᵀ are those of Σ w x × r
    twist = torch.stack([
        moment[..., (axis + 2) % 3, (axis + 1) % 3] - moment[..., (axis + 1) % 3, (axis + 2) % 3]
        for axis in range(3)
    ], -1)  # fmt: skip
    push = force[..., 3]
    hung = below @ push
    return push.sum(1), below @ twist - torch.linalg.cross(bones[..., 3], hung)


def hessian_by_rotations(
    bones: Float[Tensor, "rows 22 3 4"], stiffness: Float[Tensor, "rows 22 4 4"]
) -> tuple[Float[Tensor, " rows"], Float[Tensor, "rows 3 66"], Float[Tensor, "rows 66 66"]]:
    """Gauss-Newton Hessian by translation and joint rotations (world axes), in three blocks.

    With the points x that hang from joint b, which is a or hangs from it, weighed by w, and
    U = Σ w (x - p_a) (x - p_b)ᵀ, those by turns about a and b are tr(U) - Uᵀ, as in a body's
    tensor of inertia.
    """
    rows, below = len(bones), BELOW.to(bones)
    carried = bones @ stiffness
    second, first, mass = carried @ bones.mT, carried[..., 3], stiffness[..., 3, 3]
    second = (below @ second.flatten(2)).unflatten(-1, (3, 3))
    first, mass = below @ first, mass @ below.mT
    joints = bones[..., 3]
    lever = first - mass[..., None] * joints
    # own[b] is Σ w x (x - p_b)ᵀ over the points x that hang from joint b, which is at p_b
    own = second - first[..., None] * joints[..., None, :]
    upper, lower = _HANGING
    moments = own[:, lower] - joints[:, upper, :, None] * lever[:, lower, None, :]
    turned = -moments.mT
    turned.diagonal(dim1=-2, dim2=-1).add_(moments.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None])
    between = bones.new_zeros(rows, _BONES, _BONES, 3, 3)
    between[:, upper, lower] = turned
    between[:, lower, upper] = turned.mT
    between = between.transpose(2, 3).reshape(rows, 3 * _BONES, 3 * _BONES)
    return mass[:, 0], -so3.hat(lever).transpose(1, 2).reshape(rows, 3, -1), between


_MAX_STEP_RAD = 0.6
"""Radians, of any joint, that one step turns at most."""
_SHIFT = 0.5
"""Metres that one step moves the body at most."""


@dataclass(frozen=True)
class BoneTargets(TensorStruct):
    """Measured points of some frames, each with its place on a bone."""

    points: Float[Tensor, "rows points 3"]
    """Positions that were seen, metres."""
    weight: Float[Tensor, "rows points"]
    """Inverse variance of a coordinate, 1 / metres²; zero for rows without a point."""
    bone: Int[Tensor, "rows points"]
    place: Float[Tensor, "rows points 3"]
    """Vector from the joint of the bone to the point, in the bone's frame, metres."""

    def residuals(self, state: "BonePoses") -> Float[Tensor, "rows points 3"]:
        """Predicted less measured positions: the residuals with opposite sign, metres."""
        pick = self.bone[..., None, None].expand(*self.bone.shape, 3, 4)
        placed = state.bones.gather(1, pick)
        predicted = (placed[..., :3] @ self.place[..., None])[..., 0] + placed[..., 3]
        return predicted - self.points


@dataclass(frozen=True)
class BonePoses(TensorStruct):
    """Poses of several frames of a body, with the resulting bone orientations and joints."""

    translation: Float[Tensor, "rows 3"]
    """As in `Motion`: the body turns about its rest pelvis, and is then moved by this vector."""
    root: Float[Tensor, "rows 3 3"]
    coordinates: Float[Tensor, "rows 63"]
    """Coordinates z of the other joints; see `PoseDensity`."""
    rotations: Float[Tensor, "rows 22 3 3"]
    bones: Float[Tensor, "rows 22 3 4"]
    """Orientation and joint of every bone, [O_b | p_b], world."""

    @classmethod
    def of(
        cls,
        translation: Float[Tensor, "rows 3"],
        root: Float[Tensor, "rows 3 3"],
        coordinates: Float[Tensor, "rows 63"],
        solver: "PoseSolver",
    ) -> "BonePoses":
        """Poses of a skeleton from translations, root rotations and pose coordinates."""
        rotations = torch.cat((root[:, None], solver.density.rotations(coordinates)), 1)
        orientations, joints = forward_kinematics(rotations, solver.rest)
        joints = joints + translation[:, None]
        bones = torch.cat((orientations, joints[..., None]), -1)
        return cls(translation, root, coordinates, rotations, bones)

    @property
    def joints(self) -> Float[Tensor, "rows 22 3"]:
        """Positions of the joints, world, metres."""
        return self.bones[..., 3]


@dataclass(frozen=True)
class PoseSolver(TensorStruct):
    """Fits poses to points by damped Gauss-Newton steps, under a density of poses."""

    rest: Float[Tensor, "22 3"]
    """Joints of the unposed body, metres."""
    density: PoseDensity

    def minimised(
        self,
        state: BonePoses,
        targets: Callable[[BonePoses], BoneTargets],
        sigmas: tuple[float, ...],
        penalty: "PoseChangePenalty | None",
    ) -> BonePoses:
        """The poses after one damped Gauss-Newton step per scale of the kernel, largest first.

        The energy of a frame is ½ Σ w ρ(|predicted - seen|²) + ½ |z|², with Geman and McClure's
        kernel ρ, whose scale shrinks from step to step: what is far away counts at first and not
        in the end.

        Args:
            state: where to begin.
            targets: the points as they are matched with poses.
            sigmas: scales of the kernel, metres, one for each step.
            penalty: on changes between neighbouring frames; None leaves them independent.
        """
        annealed = _AnnealedPoses(self, targets, sigmas, penalty)
        options = GaussNewton(len(sigmas), tolerance=0.0, damping=0.0)
        return minimise(annealed, (state, 0), options)[0][0]

    def moved(self, state: BonePoses, steps: Float[Tensor, "rows 69"]) -> BonePoses:
        """Apply steps to poses; a step that would rotate or move the body too far is shortened."""
        joints = (steps[:, 6:] @ self.density.basis.mT).unflatten(-1, (ROTATIONS, 3))
        turns = torch.cat((steps[:, None, 3:6], joints), 1).norm(dim=-1)
        long = turns.amax(-1) / _MAX_STEP_RAD
        far = steps[:, :3].norm(dim=-1) / _SHIFT
        steps = steps / torch.maximum(long, far).clamp(min=1)[:, None]
        return BonePoses.of(
            state.translation + steps[:, :3],
            so3.exp(steps[:, 3:6]) @ state.root,
            state.coordinates + steps[:, 6:],
            self,
        )


@dataclass(frozen=True)
class PoseChangePenalty:
    """Quadratic penalty on changes of translation, root and pose from each frame to the next."""

    place: float
    """Inverse variance of the step of a coordinate of the pelvis, 1 / metres²."""
    turn: float
    """Inverse variance of the root's turn, 1 / radians²."""
    coordinates: float
    """Inverse variance of the change of a coordinate z."""

    def weights_and_gradients(
        self, state: BonePoses
    ) -> tuple[Float[Tensor, " 69"], Float[Tensor, "between 69"]]:
        """Penalty weights, and the penalties' gradients by the later frame of each pair."""
        like = state.translation
        weight = torch.cat((
            like.new_full((3,), self.place),
            like.new_full((3,), self.turn),
            like.new_full((COORDINATES,), self.coordinates),
        ))  # fmt: skip
        between = torch.cat((
            state.translation.diff(dim=0),
            so3.log(state.root[1:] @ state.root[:-1].mT),
            state.coordinates.diff(dim=0),
        ), -1)  # fmt: skip
        return weight, weight * between


@dataclass(frozen=True)
class _AnnealedPoses(Problem[tuple[BonePoses, int]]):
    """Least-squares problem over the poses of all frames; every step has its own kernel scale."""

    solver: PoseSolver
    targets: Callable[[BonePoses], BoneTargets]
    sigmas: tuple[float, ...]
    penalty: PoseChangePenalty | None

    def model(self, x: tuple[BonePoses, int], rows: Int[Tensor, " rows"]) -> Quadratic:
        """Reweighted least squares linearised at the poses; one matrix holds all rows (frames)."""
        state, sigma, targets = x[0], self.sigmas[x[1]], self.targets(x[0])
        away = targets.residuals(state)
        share = sigma**2 / (sigma**2 + away.square().sum(-1))
        force, stiffness = _bone_derivatives(targets, away, targets.weight * share.square())
        gradient, own = _derivatives_by_coordinates(state, force, stiffness, self.solver.density)
        gradient[:, 6:] += state.coordinates
        diagonal = own.diagonal(dim1=1, dim2=2)
        diagonal[:, 6:] += 1
        diagonal += 1e-3 * diagonal + 1.0
        # frames without a solution keep their pose and do not affect the others
        lost = ~gradient.isfinite().all(-1)
        gradient[lost], own[lost] = 0.0, torch.eye(own.shape[-1])
        inner = own[:, None]
        if self.penalty is not None:
            weight, pull = self.penalty.weights_and_gradients(state)
            gradient[:-1] -= pull
            gradient[1:] += pull
            diagonal[:-1] += weight
            diagonal[1:] += weight
            between = pad(-weight.expand_as(pull), (0, 0, 0, 1)).diag_embed()
            inner = torch.stack((own, between), 1)
        nothing = own.new_zeros(len(own), own.shape[-1], 0)
        hessian = Banded(inner, nothing, own.new_zeros(0, 0))
        return Quadratic(self.value(x, rows), gradient.flatten()[None], [hessian])

    def moved(
        self, x: tuple[BonePoses, int], rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> tuple[BonePoses, int]:
        """Apply steps to the poses and go on to the next kernel scale."""
        del rows
        state = x[0]
        framed = steps[0].view(len(state.translation), -1)
        return self.solver.moved(state, framed), x[1] + 1


def placed_rigidly(
    targets: BoneTargets,
    rest: Float[Tensor, "22 3"],
    trunk: Bool[Tensor, "rows points"],
    sigmas: tuple[float, ...],
) -> tuple[Float[Tensor, "rows 3"], Float[Tensor, "rows 3 3"]]:
    """Align the rest body rigidly with the points of the trunk; return translation and root.

    Procrustes' problem with the weights of Geman and McClure's kernel, whose scale shrinks.
    Moments with fewer than three such points are laid on all of theirs.

    Args:
        targets: the points.
        rest: joints of the unposed body, metres.
        trunk: which of the points are of it.
        sigmas: scales of the kernel, metres.
    """
    few = ((targets.weight > 0) & trunk).sum(-1) < 3
    weight = targets.weight * (trunk | few[:, None])
    model = rest[targets.bone] + targets.place - rest[0]
    place, turn = _aligned_rigidly(targets.points, model, weight)
    for sigma in sigmas:
        away = model @ turn.mT + place[:, None] - targets.points
        share = (sigma**2 / (sigma**2 + away.square().sum(-1))).square()
        place, turn = _aligned_rigidly(targets.points, model, weight * share)
    return place, turn


def _aligned_rigidly(
    points: Float[Tensor, "rows points 3"],
    model: Float[Tensor, "rows points 3"],
    weight: Float[Tensor, "rows points"],
) -> tuple[Float[Tensor, "rows 3"], Float[Tensor, "rows 3 3"]]:
    """The rigid transform that aligns the model with the points by least squares."""
    total = weight.sum(-1).clamp(min=1e-9)[:, None]
    centre = (weight[..., None] * points).sum(1) / total
    model_centre = (weight[..., None] * model).sum(1) / total
    centred = points - centre[:, None], model - model_centre[:, None]
    covariance = torch.einsum("rn,rni,rnj->rij", weight, *centred)
    turn = so3.nearest_rotation(covariance.double()).to(model)
    return centre - (turn @ model_centre[..., None])[..., 0], turn


def _bone_derivatives(
    targets: BoneTargets,
    away: Float[Tensor, "rows points 3"],
    weight: Float[Tensor, "rows points"],
) -> tuple[Float[Tensor, "rows 22 3 4"], Float[Tensor, "rows 22 4 4"]]:
    """Derivatives of the energy by the bones' 3x4 poses, and second moments of their points."""
    column = torch.cat((targets.place, torch.ones_like(targets.place[..., :1])), -1)
    counted = column * weight[..., None]
    products = torch.cat((
        (away[..., :, None] * counted[..., None, :]).flatten(-2),
        (column[..., :, None] * counted[..., None, :]).flatten(-2),
    ), -1)  # fmt: skip
    own = torch.nn.functional.one_hot(targets.bone, _BONES).to(products)
    sums = own.mT @ products
    return sums[..., :12].unflatten(-1, (3, 4)), sums[..., 12:].unflatten(-1, (4, 4))


def _derivatives_by_coordinates(
    state: BonePoses,
    force: Float[Tensor, "rows 22 3 4"],
    stiffness: Float[Tensor, "rows 22 4 4"],
    density: PoseDensity,
) -> tuple[Float[Tensor, "rows 69"], Float[Tensor, "rows 69 69"]]:
    """Gradient and Gauss-Newton Hessian by translation, root rotation (world axes) and z."""
    bones = state.bones
    pull, turning = gradient_by_rotations(bones, force)
    mass, across, between = hessian_by_rotations(bones, stiffness)
    steps = (state.coordinates @ density.basis.mT).unflatten(-1, (ROTATIONS, 3))
    bent = bones[:, 1:, :, :3] @ right_jacobian(steps)
    # Jacobian of all joint rotations by the root's rotation and by pose coordinates z
    whole = bones.new_zeros(len(bones), 3 * _BONES, 3 + COORDINATES)
    whole[:, :3, :3] = torch.eye(3)
    whole[:, 3:, 3:] = (bent @ density.basis.unflatten(0, (ROTATIONS, 3))).flatten(1, 2)
    turning = (turning.flatten(1)[:, None] @ whole)[:, 0]
    across, between = across @ whole, whole.mT @ between @ whole
    placed = mass[:, None, None] * torch.eye(3).to(bones)
    upper = torch.cat((placed, across), -1)
    hessian = torch.cat((upper, torch.cat((across.mT, between), -1)), 1)
    return torch.cat((pull, turning), -1), hessian
