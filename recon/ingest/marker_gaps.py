"""Fills frames and limbs without markers from neighbouring frames.

Frames before the first and after the last with enough markers to place a body are left out. Where
a limb has no markers, its rotations are interpolated between the poses in which it is seen before
and after; so is the whole body. A limb that never has a marker keeps the natural pose of the fit.
"""

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from observations.start.rigid import TORSO
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, descendants, joint_index
from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.ingest.marker_poses import Poses
from recon.method import windows
from recon.mocap.recording import MarkerRecording

_TORSO_MARKERS = 3
"""Fewest visible markers of the torso that suffice to place a body."""
_SHARE = 1 / 3
"""Share of all markers, wherever on the body, above which they suffice as well."""
_REACH = 0.14
"""Largest distance (m) on the body at rest of a marker from a joint whose position it shows."""
_ABOUT_PELVIS = (0, *(joint_index(name) for name in ("left_hip", "right_hip", "spine1")))
_LIMBS = {
    f"{side} {part}": tuple(f"{side}_{joint}" for joint in joints)
    for side in ("left", "right")
    for part, joints in (("arm", ("elbow", "wrist")), ("leg", ("knee", "ankle")))
} | {"trunk": ("spine3",), "pelvis": ("pelvis",)}
_SHORT = 0.25
"""Longest gap (s) of a limb that interpolation fills so well that no warning is needed."""


def placed_frames(
    visible: Bool[Tensor, "time markers"], bones: tuple[int, ...]
) -> Bool[Tensor, " time"]:
    """Return a mask of frames whose visible markers suffice to find where the body is."""
    torso = torch.tensor([bone in TORSO for bone in bones])
    enough = (visible & torso).sum(-1) >= _TORSO_MARKERS
    return enough | (visible.sum(-1) > _SHARE * visible.shape[-1])


def trimmed_recording(
    recording: MarkerRecording, bones: tuple[int, ...]
) -> tuple[MarkerRecording, tuple[str, ...]]:
    """Cut a recording to its first and last frame with enough markers; also return a note.

    Args:
        recording: with markers; the cut one keeps its clock.
        bones: the bone that moves each marker most.
    """
    placed = placed_frames(torch.from_numpy(recording.visible), bones).nonzero()[:, 0].tolist()
    if not placed:
        return recording, ()
    kept = recording.window(placed[0], placed[-1] + 1)
    before, after = placed[0], recording.frames - 1 - placed[-1]
    if before == after == 0:
        return recording, ()
    parts = [f"the {where} {n}" for where, n in (("first", before), ("last", after)) if n]
    return kept, (
        f"{' and '.join(parts)} of {recording.frames} frames show too few markers to place a body "
        f"and are left out: the motion begins at {kept.start_time:.3f} s of the recording",
    )


def observed_joints(
    visible: Bool[Tensor, "time markers"],
    vertices: tuple[int, ...],
    body: BodyModel,
) -> Bool[Tensor, "time 22"]:
    """Return a mask of joints that a visible marker locates: near it, or on a bone below it.

    The pelvis, below which all bones are, is located only by markers near it or on it, on thighs
    and on the lowest spine.
    """
    bones = body.weights[list(vertices)].argmax(-1)
    away = torch.cdist(body.joint_template, body.template[list(vertices)])
    shows = away < _REACH
    shows[0] |= torch.isin(bones, torch.tensor(_ABOUT_PELVIS))
    for joint in range(1, len(JOINTS)):
        shows[joint] |= torch.isin(bones, torch.tensor(descendants(joint)))
    seen = (visible[:, None] & shows).any(-1)
    return seen & placed_frames(visible, tuple(bones.tolist()))[:, None]


def joints_with_shown_rotation(
    visible: Bool[Tensor, "time markers"], bones: tuple[int, ...]
) -> Bool[Tensor, "time 22"]:
    """Return a mask of joints whose rotation a visible marker on or below their bone shows."""
    shows = torch.tensor(
        [[bone in descendants(joint) for bone in bones] for joint in range(len(JOINTS))]
    )
    return (visible[:, None] & shows).any(-1)


def with_gaps_filled(
    motion: Motion,
    known: Int[Tensor, " known"],
    seen_joints: Bool[Tensor, "time 22"],
) -> Motion:
    """Interpolate a motion to all frames, and each joint over frames without markers for it.

    Args:
        motion: poses of the known frames.
        known: numbers of these frames among all, ascending.
        seen_joints: whether markers determine each joint's rotation, in all frames.
    """
    everything = torch.arange(len(seen_joints))
    whole = interpolated_poses(motion, known, everything)
    rotations = whole.rotations.clone()
    here = torch.zeros(len(seen_joints), dtype=torch.bool)
    here[known] = True
    for joint in range(1, len(JOINTS)):
        shown = (seen_joints[:, joint] & here).nonzero()[:, 0]
        if 0 < len(shown) < len(seen_joints):
            sparse = frames_of(whole, shown)
            rotations[:, joint] = interpolated_poses(sparse, shown, everything).rotations[:, joint]
    return whole.replace(rotations=rotations)


def frames_of(motion: Motion, frames: Int[Tensor, " frames"]) -> Motion:
    """Return a motion of the frames with given numbers, one after the other."""
    return Motion.create(
        motion.translation[frames], motion.rotations[frames], motion.shape, motion.fps
    )


def interpolated_poses(
    motion: Motion, known_frames: Int[Tensor, " known"], wanted_frames: Int[Tensor, " wanted"]
) -> Motion:
    """Interpolate poses between known frames; beyond them, repeat the nearest known pose."""
    poses = motion.translation, motion.rotations
    between = windows.interpolated_poses(*poses, known_frames, wanted_frames)
    return Motion.create(*between, motion.shape, motion.fps)


def with_poses(motion: Motion, frames: Int[Tensor, " frames"], poses: Motion | Poses) -> Motion:
    """Return a copy of the motion with new poses in the given frames."""
    return motion.replace(
        translation=motion.translation.index_copy(0, frames, poses.translation),
        rotations=motion.rotations.index_copy(0, frames, poses.rotations),
    )


def widened_flags(flags: Bool[Tensor, " time"], frames: int) -> Bool[Tensor, " time"]:
    """Return flags that are true also for a number of frames before and after each true one."""
    wide = torch.nn.functional.max_pool1d(
        flags[None, None].float(), 2 * frames + 1, stride=1, padding=frames
    )
    return wide[0, 0] > 0


def gap_findings(observed: Bool[Tensor, "time 22"], fps: float) -> list[Finding]:
    """Make findings about frames with too few markers and about limbs hidden for a while."""
    found: list[Finding] = []
    empty = ~observed.any(-1).numpy()
    if empty.any():
        found.append(
            Finding(
                "gap",
                f"{empty.sum()} of {len(empty)} frames have too few markers to place a body "
                f"({spans(stretches(empty))}): there the pose and place are held or interpolated "
                "from those seen before and after, and `observed` is false",
                (),
                stretches(empty),
                float(empty.sum() / fps),
            )
        )
    limbs: list[str] = []
    joints: list[str] = []
    hidden = np.zeros(len(empty), dtype=bool)
    for limb, names in _LIMBS.items():
        rows = [JOINTS.index(name) for name in names]
        unseen = ~observed[:, rows].all(-1).numpy() & ~empty
        never = bool(unseen[~empty].all())
        for first, last in () if never else stretches(unseen):
            # interpolation fills short gaps well enough not to mention them
            unseen[first : last + 1] = last - first + 1 > _SHORT * fps
        if not unseen.any():
            continue
        limbs.append(f"{limb} (never seen)" if never else limb)
        shown = observed[~empty][:, rows].all(0).tolist()
        joints += [name for name, known in zip(names, shown, strict=True) if not known]
        hidden |= unseen
    if limbs:
        found.append(
            Finding(
                "unseen",
                f"no marker shows {listed(limbs, 6)} ({spans(stretches(hidden))}): their pose is "
                "that before and after, or a natural one where they are never seen, and "
                "`observed` is false",
                tuple(joints),
                stretches(hidden),
                float(hidden.mean()),
            )
        )
    return found
