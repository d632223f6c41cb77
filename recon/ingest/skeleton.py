"""All frames of recordings of one calibrated skeleton, with its shape and offsets held."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from observations.joints3d import Joints3D
from recon.body.model import BodyModel
from recon.core.motion import Motion, pad
from recon.core.scene import Scene
from recon.core.skeleton import JOINTS, PARENTS
from recon.formats.mocap.recording import SkeletonRecording
from recon.ingest.subject import BoneOrientations, Frames, SubjectModel, joint_terms
from recon.method import terms
from recon.method.free import FreeMotion
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS

BONES_WEIGHT = 0.02
REST_WEIGHT = 2e-4
SOLVE_ITERATIONS = 90


@dataclass(frozen=True)
class Solved:
    """One recording on our body."""

    motion: Motion
    residuals: Float[Tensor, " points"]
    """Mean distance of every mapped joint from the recorded one after offsets, metres."""
    source_feet: Float[Tensor, "time feet 3"]
    """Recorded ankles and toes, metres."""


def solve(
    recordings: Sequence[SkeletonRecording], subject: SubjectModel, body: BodyModel
) -> list[Solved]:
    """Motions of recordings with one frame rate, as a batch of independent clips.

    Every frame begins with the recorded orientations, aligned to our bones, and is moved until
    joints meet theirs: no term couples frames, so nothing is smoothed or delayed.
    """
    frames = [Frames.of(r, subject.skeleton) for r in recordings]
    motion = pad(
        [_start(f, subject, body, r.fps) for f, r in zip(frames, recordings, strict=True)]
    )
    fps, clips, longest = motion.fps, len(frames), motion.frames

    def padded(tensors: list[Tensor]) -> Tensor:
        out = tensors[0].new_zeros(clips, longest, *tensors[0].shape[1:])
        for row, tensor in enumerate(tensors):
            out[row, : len(tensor)] = tensor
        return out

    points = subject.skeleton.joints
    seen = Joints3D(
        positions=padded([f.positions for f in frames]),
        visible=motion.valid[..., None].expand(-1, -1, len(points)).contiguous(),
        joints=points,
        fps=fps,
        offset_rows=(0, len(points)),
    )
    targets = padded([f.orientations @ subject.alignments for f in frames])
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
    scene = Scene(subject.offsets.expand(clips, -1, -1))
    estimate, _ = run_stages((stage,), body, motion, scene)
    with torch.no_grad():
        apart = (seen.predicted(estimate) - seen.positions).norm(dim=-1)
    found = estimate.motion.detach()
    solved = []
    for row, f in enumerate(frames):
        count = len(f.positions)
        solved.append(
            Solved(
                motion=found[row].window(0, count),
                residuals=apart[row, :count].mean(0),
                source_feet=f.positions[:, slice(*subject.skeleton.feet)],
            )
        )
    return solved


def _start(frames: Frames, subject: SubjectModel, body: BodyModel, fps: float) -> Motion:
    """Recorded orientations; bones without a record keep their place in their parent."""
    targets = frames.orientations @ subject.alignments
    recorded = {bone: targets[:, row] for row, bone in enumerate(subject.skeleton.bones)}
    world: list[Tensor] = []
    identity = torch.eye(3).expand(len(targets), 3, 3)
    for joint, parent in enumerate(PARENTS):
        above = identity if parent < 0 else world[parent]
        world.append(recorded.get(joint, above))
    local = [
        world[j] if p < 0 else world[p].transpose(-1, -2) @ world[j] for j, p in enumerate(PARENTS)
    ]
    motion = Motion.create(
        translation=torch.zeros(len(targets), 3),
        rotations=torch.stack(local, 1),
        shape=subject.shape,
        fps=fps,
    )
    posed = body.pose(motion)
    points = list(subject.skeleton.joints)
    predicted = posed.joints[:, points] + (
        posed.orientations[:, points] @ subject.offsets[..., None]
    ).squeeze(-1)
    return motion.replace(translation=(frames.positions - predicted).mean(1))


def residual_names(subject: SubjectModel) -> tuple[str, ...]:
    """Names of our joints in the order of `Solved.residuals`."""
    return tuple(JOINTS[joint] for joint in subject.skeleton.joints)
