"""Bones lost in the 31-joint BVH conversion of the CMU database (cgspeed, B. Hahne 2008).

The converter gave no length to a bone with several children: thorax, and `wrist`, the far third
of the forearm (its joint `LeftHand` is where the radius bone ends, not the wrist). Neck and
shoulders thus sit 12 cm too low, fingers 9 cm too near the elbow. The skeletons those files come
from (ASF) have a thorax as long as the upper back (1.001 to 1.007 times, three subjects) and a
`wrist` half as long as `radius` (0.50000), in line with it; that is put back here. Then all joints
agree with the original AMC files, and shoulders are 5 cm from their markers, not 16.

The wrist of the body is the joint `LeftFingerBase` (`lhand` in ASF).
"""

import dataclasses

import numpy as np

from recon.formats.mocap.recording import SkeletonRecording

_LOST = (("Spine1", 1.0), ("LeftHand", 0.5), ("RightHand", 0.5))
"""Joint of a lost bone, and its length as a share of the bone before it."""
_SIGNATURE = {"LHipJoint", "RHipJoint", "LowerBack", "Neck1", "LeftFingerBase", "RightFingerBase"}


def restore_lost_bones(recording: SkeletonRecording) -> SkeletonRecording:
    """Give the lost bones their length back; any other skeleton is returned as it is."""
    if not set(recording.joint_names) >= _SIGNATURE:
        return recording
    offsets, positions = recording.rest_offsets.copy(), recording.positions.copy()
    restored: list[str] = []
    for name, share in _LOST:
        joint = recording.joint(name)
        children = [c for c, p in enumerate(recording.parents) if p == joint]
        if np.abs(offsets[children]).max() > 1e-6:
            continue
        bone = offsets[joint] * share
        offsets[children] = bone
        below = recording.descendants(joint)[1:]
        positions[:, below] += (recording.orientations[:, joint] @ bone)[:, None]
        restored.append(f"{name} {np.linalg.norm(bone):.3f} m")
    if not restored:
        return recording
    reason = f"bones lost by the cgspeed conversion restored: {', '.join(restored)}"
    return dataclasses.replace(
        recording,
        rest_offsets=offsets,
        positions=positions,
        decisions=(*recording.decisions, reason),
    )
