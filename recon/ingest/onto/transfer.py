"""A motion of one body on another mesh, whose surface then lies where the first one does."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.geometry.closest import closest_points
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.ingest.markers.points import Poses, SkinPoints
from recon.ingest.markers.poses import PoseEnergies
from recon.ingest.onto.rest import Aligned, align
from recon.solver.levenberg_marquardt import LevenbergMarquardt, minimise_frames

POINTS = 700
"""Vertices of the target that hold its poses."""
_OUTLIER = 0.03
"""Metres beyond which a point counts ever less."""
_SETTINGS = LevenbergMarquardt(max_iterations=30)
_JUDGED = 20
"""Frames at which the distance of the surfaces is measured, spread over the motion."""


@dataclass(frozen=True)
class Transferred:
    """A motion on another body, and how near it is."""

    motion: Motion
    distances: Float[np.ndarray, "frames vertices"]
    """Distance of every vertex of the target from the first body's surface, at some frames spread
    over the motion, metres."""


def transfer(motion: Motion, body: BodyModel, target: BodyModel) -> Transferred:
    """A motion of one body as a motion of another one, with the other's own shape coefficients.

    Shape and rest pose are fitted to the first body's surface; then every frame's pose brings
    points of the target's skin to those points of the first one's on which they lie at rest.

    Args:
        motion: one clip without a batch axis.
        body: whose motion it is.
        target: the body that moves then.

    Raises:
        ReconError: when the motion has a batch axis.
    """
    if motion.translation.ndim != 2:
        raise ReconError("expected one clip without a batch axis; bring over motion[k]")
    dtype = motion.translation.dtype
    motion = motion.to(dtype=torch.float64)
    body, target = body.to(dtype=torch.float64), target.to(dtype=torch.float64)
    rest = align(body, motion.shape, target)
    moved = _posed(motion, body, target, rest)
    return Transferred(moved.to(dtype=dtype), _distances(motion, body, moved, target))


def _posed(motion: Motion, body: BodyModel, target: BodyModel, rest: Aligned) -> Motion:
    vertices = torch.arange(0, len(target.template), max(1, len(target.template) // POINTS))
    there = target.pose(rest.motion()).points(vertices)[0].numpy()
    surface = body.rest_vertices(motion.shape).numpy()
    met = closest_points(there, surface, body.faces.numpy())
    shares = torch.from_numpy(met.shares)
    corners, back = np.unique(met.triangles, return_inverse=True)
    skin = body.pose(motion).points(torch.from_numpy(corners))
    asked = skin[:, torch.from_numpy(back.reshape(met.triangles.shape))]
    positions = torch.einsum("pc,tpcd->tdp", shares, asked)
    local, translation = _begun(motion, body, target, rest)
    # what at rest is far from the other surface is a part that only one body has
    far = torch.from_numpy(np.linalg.norm(met.places - there, axis=-1)) > _OUTLIER
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
        sigma=_OUTLIER,
    )
    begun = Poses.of(translation, local, energies.rest)
    found = minimise_frames(energies, begun, _SETTINGS).state
    return motion.replace(
        translation=found.translation, rotations=found.rotations, shape=rest.shape
    )


def _begun(
    motion: Motion, body: BodyModel, target: BodyModel, rest: Aligned
) -> tuple[Float[Tensor, "time 22 3 3"], Float[Tensor, "time 3"]]:
    """Bones turned as those of the first body are, from the pose in which the two agree."""
    posed = body.pose(motion)
    world = posed.orientations @ rest.orientations
    local = torch.cat((world[:, :1], world[:, list(PARENTS[1:])].mT @ world[:, 1:]), 1)
    pelvis = target.rest_joints(rest.shape)[0]
    offset = pelvis + rest.translation - body.rest_joints(motion.shape)[0]
    place = posed.joints[:, 0] + posed.orientations[:, 0] @ offset
    return local, place - pelvis


def _distances(
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
