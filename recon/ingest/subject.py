"""Calibrates the body model to a recorded skeleton: shape, joint offsets, bone alignments."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations.joints3d import Joints3D
from recon.body.levelling import standing_flat
from recon.body.model import BodyModel
from recon.body.soles import Soles
from recon.core import rotations as so3
from recon.core.scene import Scene
from recon.core.skeleton import FEET
from recon.core.struct import TensorStruct
from recon.ingest.maps import SkeletonMap, alignments_from_rest
from recon.method import terms
from recon.method.free import FreeMotion
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.mocap.recording import SkeletonRecording
from recon.solver.lbfgs import LBFGS


@dataclass(frozen=True)
class BoneOrientations(TensorStruct):
    """Energy of the angles between bones and their recorded orientations."""

    orientations: Float[Tensor, "*batch time bones 3 3"]
    """Rotation of each bone from its rest pose to the world."""
    bones: tuple[int, ...]
    """Numbers of the joints whose bones have recorded orientations."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Return Σ (1 - cos angle) over bones and frames, at 30 frames/s: ½ angle² if small.

        It determines what joint positions do not: rotations about a bone, of head, hands and toes.
        """
        motion = estimate.motion
        ours = estimate.body.orientations[..., list(self.bones), :, :]
        angles = (3.0 - (ours * self.orientations).sum((-1, -2))) / 2
        total = angles.sum(-1).where(motion.valid, 0.0).sum(-1)
        return total * (REFERENCE_FPS / motion.fps)


@dataclass(frozen=True)
class FlatSoles(TensorStruct):
    """Energy of standing feet: half the square of the height of heel above ball, metres²."""

    standing: Bool[Tensor, "*batch time 2"]
    """Whether the left and the right foot stand flat in each frame."""
    heels: Int[Tensor, "2 points"]
    """Vertices under the left and the right heel."""
    balls: Int[Tensor, "2 points"]
    """Vertices under the balls of the feet."""

    def __getitem__(self, index: Tensor) -> "FlatSoles":
        """Return this energy restricted to some clips of the batch."""
        return self.replace(standing=self.standing[index])

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Return ½ Σ (z_heel - z_ball)² over standing feet, scaled to 30 frames per second."""
        motion, body = estimate.motion, estimate.body
        shape = self.heels.shape
        heels = body.points(self.heels.flatten())[..., 2].unflatten(-1, shape).mean(-1)
        balls = body.points(self.balls.flatten())[..., 2].unflatten(-1, shape).mean(-1)
        tilt = (heels - balls).square().where(self.standing & motion.valid[..., None], 0.0)
        return 0.5 * tilt.sum((-1, -2)) * (REFERENCE_FPS / motion.fps)


logger = logging.getLogger(__name__)

FRAMES = 240
"""Most frames, of different poses, from which a person is calibrated."""
_CANDIDATES = 3000
_ROOT = frozenset({"translation", "root"})
_BODY = _ROOT | {"pose", "shape"}

FEET_WEIGHT = 6.0
"""Weight of ankles and toes relative to other joints: feet must not slip."""


@dataclass(frozen=True)
class CalibrationWeights:
    """Weights of the calibration's energies relative to ½ Σ distance² of joints, metres²."""

    shape: float = 6e-5
    """Weight per frame of squared shape coefficients; 1 costs as much as 2 mm at all joints."""
    offsets: float = 0.15
    """Weight per frame of offsets, relative to that of the same distance as an error."""
    feet_offsets: float = 3.0
    """Additional weight of the offsets of ankles and toes: with an offset, a foot that rolls would
    slip."""
    rest: float = 1e-3
    """Weight of the rest pose in the first stage, for joints that nothing else determines."""
    bones: float = 0.02
    soles: float = 4.0


@dataclass(frozen=True)
class SubjectModel(TensorStruct):
    """The body model calibrated to a recorded skeleton: shape, joint offsets, bone alignments."""

    shape: Float[Tensor, " shape"]
    offsets: Float[Tensor, "points 3"]
    """Offset of each recorded joint from the model's, in the frame of the model's bone, metres."""
    alignments: Float[Tensor, "bones 3 3"]
    """Rotations such that the model's bone orientation = recorded orientation · alignment."""
    skeleton: SkeletonMap


@dataclass(frozen=True)
class MappedFrames(TensorStruct):
    """Recorded positions and orientations of the mapped joints, in the order of the map."""

    positions: Float[Tensor, "time points 3"]
    orientations: Float[Tensor, "time bones 3 3"]
    standing: Bool[Tensor, "time 2"]

    @classmethod
    def of(cls, recording: SkeletonRecording, skeleton: SkeletonMap) -> "MappedFrames":
        """Take the mapped joints from all frames of a recording, and judge where feet stand."""
        points = [recording.joint(name) for _, name in skeleton.positions]
        bones = [recording.joint(name) for _, name in skeleton.orientations]
        positions = torch.from_numpy(recording.positions[:, points]).float()
        feet = positions[:, slice(*skeleton.feet_rows)]
        known = len(FEET) == feet.shape[1]
        none = torch.zeros(len(positions), 2, dtype=torch.bool)
        return cls(
            positions=positions,
            orientations=torch.from_numpy(recording.orientations[:, bones]).float(),
            standing=standing_flat(feet, recording.fps) if known else none,
        )


def calibrate(
    recordings: Sequence[SkeletonRecording],
    skeleton: SkeletonMap,
    body: BodyModel,
) -> SubjectModel:
    """Find shape, offsets and alignments of one skeleton from frames of all its recordings.

    Frames of different poses make one clip without any temporal term. Where the skeleton's zero
    pose is a T-pose it gives the first alignments; otherwise rotations about bones start as near
    to rest as the positions allow, on average over the frames. The shape is fitted to bone lengths
    first; constant offsets then take up the remaining differences.
    """
    weights = CalibrationWeights()
    frames = _diverse_frames(recordings, skeleton)
    count = len(frames.positions)
    seen = Joints3D(
        positions=frames.positions[None],
        visible=torch.ones(1, count, len(skeleton.joints), dtype=torch.bool),
        joints=skeleton.joints,
        fps=REFERENCE_FPS,
    )
    with torch.no_grad():
        motion = seen.start(body)
    scene = Scene.create(1, len(skeleton.joints), like=frames.positions)
    prior = FreeMotion()
    rest = alignments_from_rest(recordings[0], skeleton, body)
    if rest is None:
        hold: tuple[Term, ...] = (Term("rest pose", terms.rest_pose, weights.rest),)
    else:
        hold = _orientation_terms(frames, rest, skeleton, weights.bones)
    data = joint_terms(seen)
    shape = Term("shape", terms.shape, weights.shape)
    first = (
        Stage("place", prior, (*data, *hold), _ROOT, LBFGS(max_iterations=30)),
        Stage("pose", prior, (*data, shape, *hold), _BODY, LBFGS(max_iterations=100)),
    )
    estimate, _ = run_stages(first, body, motion, scene)
    soles = Soles.of(body)
    flat = FlatSoles(frames.standing[None], soles.heels, soles.balls)
    data = joint_terms(seen.replace(offset_rows=(0, len(skeleton.joints))))
    first_foot, last_foot = skeleton.feet_rows

    def feet_offsets(estimate: Estimate) -> Float[Tensor, "*batch"]:
        return 0.5 * estimate.scene.offsets[:, first_foot:last_foot].square().sum((-1, -2))

    for _ in range(3):
        aligned = _mean_alignments(frames, estimate.body.orientations[0], skeleton)
        stage = Stage(
            "offsets",
            prior,
            (
                *data,
                shape,
                Term("offsets", terms.offsets, weights.offsets * count),
                Term("feet offsets", feet_offsets, weights.feet_offsets * count),
                Term("soles", flat, weights.soles),
                *_orientation_terms(frames, aligned, skeleton, weights.bones),
            ),
            _BODY | {"scene.offsets"},
            LBFGS(max_iterations=100),
        )
        estimate, _ = run_stages((stage,), body, estimate.motion, estimate.scene)
    logger.info("calibrated %s from %d frames", recordings[0].name, count)
    return SubjectModel(
        shape=estimate.motion.shape[0],
        offsets=estimate.scene.offsets[0],
        alignments=_mean_alignments(frames, estimate.body.orientations[0], skeleton),
        skeleton=skeleton,
    ).detach()


def joint_terms(seen: Joints3D) -> tuple[Term, ...]:
    """Return terms for the positions of all joints, and an additional one for ankles and toes."""
    first, last = sum(j not in FEET for j in seen.joints), len(seen.joints)
    rows = None if seen.offset_rows is None else (first, last)
    feet = seen.replace(
        positions=seen.positions[..., first:, :],
        visible=seen.visible[..., first:],
        joints=seen.joints[first:],
        offset_rows=rows,
    )
    return Term("joints", seen, 1.0), Term("feet", feet, FEET_WEIGHT - 1)


def _orientation_terms(
    frames: MappedFrames, alignments: Tensor, skeleton: SkeletonMap, weight: float
) -> tuple[Term, ...]:
    """Return terms that hold bones at recorded orientations, and all bones weakly at rest."""
    targets = (frames.orientations @ alignments)[None]
    return (
        Term("bones", BoneOrientations(targets, skeleton.bones), weight),
        Term("rest pose", terms.rest_pose, 0.01 * weight),
    )


def _mean_alignments(
    frames: MappedFrames, ours: Float[Tensor, "time 22 3 3"], skeleton: SkeletonMap
) -> Float[Tensor, "bones 3 3"]:
    """Return the mean over frames (chordal) of the rotations from recorded to model bones."""
    between = frames.orientations.transpose(-1, -2) @ ours[:, list(skeleton.bones)]
    return so3.nearest_rotation(between.double().mean(0)).to(ours)


def _diverse_frames(
    recordings: Sequence[SkeletonRecording], skeleton: SkeletonMap
) -> MappedFrames:
    """Choose frames whose poses differ most (farthest point sampling), moved over the origin."""
    total = sum(r.frames for r in recordings)
    step = max(1, total // _CANDIDATES)
    parts = [MappedFrames.of(r, skeleton)[::step] for r in recordings]
    positions = torch.cat([p.positions for p in parts])
    root = torch.cat(
        [torch.from_numpy(r.orientations[::step, r.body_root]).float() for r in recordings]
    )
    centre = positions.mean(1, keepdim=True)
    places = ((positions - centre) @ root).flatten(1)
    count = min(FRAMES, len(places))
    chosen = [int((places - places.mean(0)).norm(dim=-1).argmin())]
    distance = (places - places[chosen[0]]).norm(dim=-1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = distance.minimum((places - places[chosen[-1]]).norm(dim=-1))
    index = torch.from_numpy(np.sort(np.array(chosen)))
    flat = torch.tensor([1.0, 1.0, 0.0])
    return MappedFrames(
        positions=(positions - centre * flat)[index],
        orientations=torch.cat([p.orientations for p in parts])[index],
        standing=torch.cat([p.standing for p in parts])[index],
    )
