"""Transfers a motion to another body model by matching their surfaces."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel, PosedBody, forward_kinematics
from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.nearest import closest_points
from recon.core.raster import vertex_normals
from recon.core.skeleton import JOINTS, PARENTS, joint_index
from recon.ingest.marker_poses import PoseEnergies, Poses, SkinPoints
from recon.ingest.tied_frames import LevenbergMarquardt, minimise_frames
from recon.solver.banded import Banded
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise

ROUNDS = 20
"""Most rounds of finding nearest points and moving towards them."""
_STEP = 1e-4
"""Step of finite differences, in metres, radians and shape coefficients."""
_OUTLIER_AT_REST = 0.02
"""Scale (m) of the robust kernel of distances at rest: hands and faces of two bodies differ."""
_ALONG = 0.15
"""Factor of residuals along the surface, relative to those across it: points may slide."""
_SHAPE_STD, _TURN_STD = 0.02, 0.05
"""Distance (m) of one point that costs as much as a shape coefficient of 1, and as a joint's
rotation by 1 radian; there are thousands of points."""
_FACING = 0.3
"""Cosine between normals below which two points belong to different sides of a limb."""
_SURFACE_OPTIONS = GaussNewton(ROUNDS, tolerance=1e-6, scale=1.0, damping=0.0)
"""Settings of the fit to a surface; it ends when the energy falls by less than 1e-6 metres²."""
_JOINT_OPTIONS = GaussNewton(6, tolerance=0.0, damping=0.0)
_JOINT_WEIGHT = 10.0
_POINTS = 1000
"""Approximate number of vertices of either surface that are compared."""
_TURNS = slice(3, 3 + 3 * len(JOINTS))
"""Rows of joints' rotation vectors in a state: after the translation, before the shape."""
_LIMBS = tuple(
    joint_index(f"{side}_{name}")
    for side in ("left", "right")
    for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
)
"""Joints of limbs, which are at like places in all body models; those of trunks are not."""


@dataclass(frozen=True)
class AlignedBody:
    """Shape and pose in which a body model's surface matches that of another one at rest."""

    shape: Float[Tensor, " shape"]
    turns: Float[Tensor, "22 3"]
    """Rotation vectors of the joints relative to their parents, radians."""
    translation: Float[Tensor, "3"]
    """Translation of the root, metres."""

    def motion(self) -> Motion:
        """Return a motion of one frame with this shape and pose."""
        rotations = so3.exp(self.turns)[None]
        return Motion.create(self.translation[None], rotations, self.shape, 30.0)

    @property
    def orientations(self) -> Float[Tensor, "22 3 3"]:
        """Rotations of the model's bones from its own rest pose to this pose."""
        local = so3.exp(self.turns)[None]
        return forward_kinematics(local, local.new_zeros(len(JOINTS), 3))[0][0]


def aligned_at_rest(
    body: BodyModel, shape: Float[Tensor, " shape"], target: BodyModel, count: int | None = None
) -> AlignedBody:
    """Find shape and pose in which the target's surface is nearest to a body at rest.

    Gauss-Newton over translation, joint rotations and shape: first on the joints of the limbs,
    then on the distances of points of either surface to the other, mostly those along its normal.
    Both bodies are in double precision.

    Args:
        body: the body at rest, to which the target is fitted.
        shape: shape coefficients of that body.
        target: the body whose shape and pose are found.
        count: number of the target's first shape coefficients that are found; None is all.
    """
    rest = body.rest_vertices(shape).numpy()
    surface = _Surface(rest, body.faces.numpy(), vertex_normals(rest, body.faces.numpy()))
    shapes = target.shape_size if count is None else count
    state = torch.zeros(_TURNS.stop + shapes, dtype=torch.float64)
    joints = body.rest_joints(shape)[list(_LIMBS)]
    state, _ = minimise(_Alignment(target, joints), state, _JOINT_OPTIONS)
    state, _ = minimise(_Alignment(target, surface), state, _SURFACE_OPTIONS)
    turns = state[_TURNS].unflatten(0, (len(JOINTS), 3))
    return AlignedBody(state[_TURNS.stop :], turns, state[:3])


@dataclass(frozen=True)
class _SurfacePairs:
    """Vertices of the posed body, with residuals to the nearest points of the other surface."""

    vertices: Int[Tensor, " pairs"]
    residuals: Float[Tensor, "pairs 3"]
    """Vertex minus its partner on the other surface, metres."""
    directions: Float[Tensor, "pairs 3"]
    """Unit normals of the other surface."""
    weights: Float[Tensor, " pairs"]


@dataclass(frozen=True)
class _Surface:
    """The surface of a body at rest (metres), with which another surface is aligned."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    normals: Float[np.ndarray, "vertices 3"]

    def pairs(
        self, here: Float[np.ndarray, "others 3"], faces: Int[np.ndarray, "faces 3"]
    ) -> _SurfacePairs:
        """Pair some vertices of either surface with the nearest points of the other one."""
        own = vertex_normals(here, faces)
        some, ours = _sparse_indices(len(here)), _sparse_indices(len(self.vertices))
        near = closest_points(here[some], self.vertices, self.faces)
        facing = np.einsum("pc,pcd->pd", near.shares, self.normals[near.triangles])
        facing /= np.linalg.norm(facing, axis=-1, keepdims=True).clip(min=1e-9)
        back = closest_points(self.vertices[ours], here, faces)
        corners = back.triangles[np.arange(len(ours)), back.shares.argmax(1)]
        vertices = np.concatenate((some, corners))
        directions = np.concatenate((facing, self.normals[ours]))
        residuals = here[vertices] - np.concatenate((near.places, self.vertices[ours]))
        seen = (own[vertices] * directions).sum(-1) > _FACING
        share = _OUTLIER_AT_REST**2 / (_OUTLIER_AT_REST**2 + np.square(residuals).sum(-1))
        arrays = (vertices, residuals, directions, np.square(share) * seen)
        return _SurfacePairs(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))


def _sparse_indices(count: int) -> Int[np.ndarray, " some"]:
    return np.arange(0, count, max(1, count // _POINTS))


def _posed_with_states(target: BodyModel, states: Float[Tensor, "states n"]) -> PosedBody:
    """Pose the target body with several states (translation, rotations, shape), one frame each."""
    turns = states[:, _TURNS].unflatten(-1, (len(JOINTS), 3))
    motion = Motion.create(
        states[:, None, :3], so3.exp(turns)[:, None], states[:, _TURNS.stop :], 30.0
    )
    return target.pose(motion)


def _points_and_derivatives(
    target: BodyModel, state: Float[Tensor, " n"], vertices: Int[Tensor, " points"] | None
) -> tuple[Float[Tensor, "points 3"], Float[Tensor, "points 3 n"]]:
    """Return vertices of the target, or its limbs' joints, and their derivatives by the state."""
    states = torch.cat((state[None], state + _STEP * torch.eye(len(state)).to(state)))
    posed = _posed_with_states(target, states)
    if vertices is None:
        points = posed.joints[:, 0, list(_LIMBS)]
    else:
        chosen, back = torch.unique(vertices, return_inverse=True)
        points = posed.points(chosen)[:, 0, back]
    return points[0], ((points[1:] - points[0]) / _STEP).movedim(0, -1)


@dataclass(frozen=True)
class _Alignment(Problem[Tensor]):
    """Energy ½ Σ w |distance|² of joints from given positions, or of vertices from a surface.

    It includes weighted squares of joint rotations and shape.
    """

    target: BodyModel
    goal: Float[Tensor, "limbs 3"] | _Surface

    def model(self, x: Tensor, rows: Int[Tensor, " rows"]) -> Quadratic:
        """Return the Gauss-Newton model of the energy about a state."""
        slopes, away, weights = self._residuals(x)
        count = len(x) - _TURNS.stop
        pull = torch.cat((
            torch.zeros(3), torch.full((_TURNS.stop - 3,), _TURN_STD),
            torch.full((count,), _SHAPE_STD),
        )).double().square()  # fmt: skip
        weighed = slopes * weights[:, None]
        normal = weighed.mT @ slopes + torch.diag(pull + 1e-9)
        gradient = weighed.mT @ away + pull * x
        return Quadratic(self.value(x, rows), gradient[None], [Banded.dense(normal)])

    def moved(
        self, x: Tensor, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> Tensor:
        """Return the state after a step."""
        del rows
        return x + steps[0]

    def _residuals(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the Jacobian, the residuals (m), and the residuals' weights."""
        if isinstance(self.goal, Tensor):
            here, slopes = _points_and_derivatives(self.target, x, None)
            away = (here - self.goal).flatten()
            return slopes.flatten(0, 1), away, torch.full_like(away, _JOINT_WEIGHT)
        every = torch.arange(len(self.target.template))
        here = _posed_with_states(self.target, x[None]).points(every)[0, 0].numpy()
        pairs = self.goal.pairs(here, self.target.faces.numpy())
        _, slopes = _points_and_derivatives(self.target, x, pairs.vertices)
        across = torch.einsum("rd,rdk->rk", pairs.directions, slopes)
        along = _ALONG**2 * pairs.weights.repeat_interleave(3)
        return (
            torch.cat((across, slopes.flatten(0, 1))),
            torch.cat(((pairs.residuals * pairs.directions).sum(-1), pairs.residuals.flatten())),
            torch.cat((pairs.weights, along)),
        )


POINTS = 700
"""Approximate number of the target's vertices to which its poses are fitted."""
_OUTLIER_IN_MOTION = 0.03
"""Scale (m) of the robust kernel of points' distances in a motion."""
_SETTINGS = LevenbergMarquardt(max_iterations=30)
_JUDGED = 20
"""Number of frames at which the distance of the surfaces is measured, spread over the motion."""


@dataclass(frozen=True)
class MotionOnOtherBody:
    """A motion transferred to another body model, and distances between the two surfaces."""

    motion: Motion
    distances: Float[np.ndarray, "frames vertices"]
    """Distance of every vertex of the target from the first body's surface, in up to 20 frames
    spread over the motion, metres."""


def transfer(motion: Motion, body: BodyModel, target: BodyModel) -> MotionOnOtherBody:
    """Convert a motion of one body model to another one, with shape coefficients of the latter.

    The target's shape and rest pose are fitted to the first body's surface; then, in every frame,
    its pose is fitted so that points of both skins coincide that coincide at rest.

    Args:
        motion: one clip without a batch axis.
        body: the model that the motion is of.
        target: the model to which it is transferred.

    Raises:
        ReconError: when the motion has a batch axis.
    """
    if motion.translation.ndim != 2:
        raise ReconError("expected one clip without a batch axis; transfer motion[k]")
    dtype = motion.translation.dtype
    motion = motion.to(dtype=torch.float64)
    body, target = body.to(dtype=torch.float64), target.to(dtype=torch.float64)
    rest = aligned_at_rest(body, motion.shape, target)
    moved = _fit_to_skin(motion, body, target, rest)
    return MotionOnOtherBody(
        moved.to(dtype=dtype), _surface_distances(motion, body, moved, target)
    )


def _fit_to_skin(motion: Motion, body: BodyModel, target: BodyModel, rest: AlignedBody) -> Motion:
    vertices = torch.arange(0, len(target.template), max(1, len(target.template) // POINTS))
    there = target.pose(rest.motion()).points(vertices)[0].numpy()
    surface = body.rest_vertices(motion.shape).numpy()
    met = closest_points(there, surface, body.faces.numpy())
    shares = torch.from_numpy(met.shares)
    used, back = np.unique(met.triangles, return_inverse=True)
    skin = body.pose(motion).points(torch.from_numpy(used))
    corners = skin[:, torch.from_numpy(back.reshape(met.triangles.shape))]
    positions = torch.einsum("pc,tpcd->tdp", shares, corners)
    local, translation = carried_rotations(motion, body, target, rest)
    # leave out vertices far from the other body's surface at rest: only one body has such parts
    far = torch.from_numpy(np.linalg.norm(met.places - there, axis=-1)) > _OUTLIER_IN_MOTION
    energies = PoseEnergies(
        rest=target.rest_joints(rest.shape),
        markers=SkinPoints.of(target, rest.shape, vertices),
        soles=None,
        positions=positions.contiguous(),
        visible=(~far).to(positions).expand(len(positions), -1).contiguous(),
        linked=torch.zeros(motion.frames - 1, dtype=torch.bool),
        natural=local[:, 1:].mean(0, keepdim=True),
        pull=positions.new_zeros(1),
        ground=0.0,
        turning=torch.zeros(len(JOINTS), dtype=torch.float64),
        sigma=_OUTLIER_IN_MOTION,
    )
    start = Poses.of(translation, local, energies.rest)
    found = minimise_frames(energies, start, _SETTINGS).state
    return motion.replace(
        translation=found.translation, rotations=found.rotations, shape=rest.shape
    )


def carried_rotations(
    motion: Motion, body: BodyModel, target: BodyModel, rest: AlignedBody
) -> tuple[Float[Tensor, "time 22 3 3"], Float[Tensor, "time 3"]]:
    """Return rotations and translation by which the target's bones turn as the first body's."""
    posed = body.pose(motion)
    world = posed.orientations @ rest.orientations
    local = torch.cat((world[:, :1], world[:, list(PARENTS[1:])].mT @ world[:, 1:]), 1)
    pelvis = target.rest_joints(rest.shape)[0]
    offset = pelvis + rest.translation - body.rest_joints(motion.shape)[0]
    place = posed.joints[:, 0] + posed.orientations[:, 0] @ offset
    return local, place - pelvis


def _surface_distances(
    motion: Motion, body: BodyModel, moved: Motion, target: BodyModel
) -> Float[np.ndarray, "frames vertices"]:
    frames = np.unique(np.linspace(0, motion.frames - 1, _JUDGED).round().astype(int))
    found: list[np.ndarray] = []
    for frame in frames.tolist():
        ours = body.pose(motion.window(frame, frame + 1)).vertices[0].numpy()
        theirs = target.pose(moved.window(frame, frame + 1)).vertices[0].numpy()
        near = closest_points(theirs, ours, body.faces.numpy())
        found.append(np.linalg.norm(near.places - theirs, axis=-1))
    return np.stack(found)
