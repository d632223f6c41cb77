"""Fits poses of the body model to a recorded skeleton, with a shape calibrated before."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from observations.joints3d import Joints3D
from recon.body.model import BodyModel
from recon.core.motion import Motion, padded_batch
from recon.core.scene import Scene
from recon.core.skeleton import PARENTS
from recon.ingest.subject import BoneOrientations, MappedFrames, SubjectModel, joint_terms
from recon.method import terms
from recon.method.free import FreeMotion
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.mocap.recording import SkeletonRecording
from recon.solver.lbfgs import LBFGS

BONES_WEIGHT = 0.02
REST_WEIGHT = 2e-4
SOLVE_ITERATIONS = 90


@dataclass(frozen=True)
class FittedSkeleton:
    """The motion of the body model fitted to one recorded skeleton, with its residuals."""

    motion: Motion
    residuals: Float[Tensor, " points"]
    """Mean distance (m) of each fitted joint, with its constant offset, from the recorded one."""
    source_feet: Float[Tensor, "time feet 3"]
    """Recorded positions of ankles and toes, metres."""


def fit_skeletons(
    recordings: Sequence[SkeletonRecording], subject: SubjectModel, body: BodyModel
) -> list[FittedSkeleton]:
    """Fit poses to recordings with one frame rate, as a batch of independent clips.

    The first guess of every frame has the recorded orientations, aligned to the model's bones;
    then joint positions are fitted. No term couples frames, so nothing is smoothed or delayed.
    """
    frames = [MappedFrames.of(r, subject.skeleton) for r in recordings]
    motion = padded_batch(
        [_first_guess(f, subject, body, r.fps) for f, r in zip(frames, recordings, strict=True)]
    )
    points = subject.skeleton.joints
    seen = Joints3D(
        positions=pad_sequence([f.positions for f in frames], batch_first=True),
        visible=motion.valid[..., None].expand(-1, -1, len(points)).contiguous(),
        joints=points,
        fps=motion.fps,
        offset_rows=(0, len(points)),
    )
    aligned = [f.orientations @ subject.alignments for f in frames]
    targets = pad_sequence(aligned, batch_first=True)
    stage = Stage(
        "frames",
        FreeMotion(),
        (
            *joint_terms(seen),
            Term("bones", BoneOrientations(targets, subject.skeleton.bones), BONES_WEIGHT),
            Term("rest pose", terms.rest_pose, REST_WEIGHT),
        ),
        frozenset({"translation", "root", "pose"}),
        LBFGS(max_iterations=SOLVE_ITERATIONS, history=10, tolerance_decrease=1e-6),
    )
    scene = Scene(subject.offsets.expand(len(frames), -1, -1))
    estimate, _ = run_stages((stage,), body, motion, scene)
    with torch.no_grad():
        apart = (seen.predicted(estimate) - seen.positions).norm(dim=-1)
    found = estimate.motion.detach()
    return [
        FittedSkeleton(
            motion=found[row].window(0, len(f.positions)),
            residuals=apart[row, : len(f.positions)].mean(0),
            source_feet=f.positions[:, slice(*subject.skeleton.feet_rows)],
        )
        for row, f in enumerate(frames)
    ]


def _first_guess(
    frames: MappedFrames, subject: SubjectModel, body: BodyModel, fps: float
) -> Motion:
    """Make a first guess from recorded orientations; bones without one follow their parents."""
    targets = frames.orientations @ subject.alignments
    recorded = {bone: targets[:, row] for row, bone in enumerate(subject.skeleton.bones)}
    identity = torch.eye(3).expand(len(targets), 3, 3)
    bones: list[Tensor] = []
    for joint, parent in enumerate(PARENTS):
        bones.append(recorded.get(joint, identity if parent < 0 else bones[parent]))
    world = torch.stack(bones, 1)
    local = torch.cat((world[:, :1], world[:, list(PARENTS[1:])].mT @ world[:, 1:]), 1)
    motion = Motion.create(
        translation=torch.zeros(len(targets), 3),
        rotations=local,
        shape=subject.shape,
        fps=fps,
    )
    posed = body.pose(motion)
    points = list(subject.skeleton.joints)
    offsets = (posed.orientations[:, points] @ subject.offsets[..., None])[..., 0]
    away = frames.positions - (posed.joints[:, points] + offsets)
    return motion.replace(translation=away.mean(1))
