"""First alignments of bones from a skeleton whose zero pose is a T-pose."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.skeleton import FEET, joint_index
from recon.formats.mocap.recording import SkeletonRecording
from recon.ingest.skeletons.maps import SkeletonMap

_WORST_BONE = 40.0
"""Degrees: no bone of a T-pose is farther from ours at rest."""
_CHILD = {
    joint_index(f"{side}_{name}"): joint_index(f"{side}_{child}")
    for side in ("left", "right")
    for name, child in (
        ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"),
    )
}  # fmt: skip
"""Bones whose direction is compared and followed; feet stand flat in any T-pose."""


def alignments_from_rest(
    recording: SkeletonRecording, skeleton: SkeletonMap, body: BodyModel
) -> Float[Tensor, "bones 3 3"] | None:
    """Alignment of every mapped bone, or None where the zero pose is no T-pose.

    At zero rotations every recorded bone has orientation I in the file's axes. Our body is laid
    on it (Q, orthogonal Procrustes of the joints) and each limb swung to the recorded direction
    by the smallest rotation S: alignment = S Q. A hand follows its forearm.
    """
    rest = np.zeros_like(recording.rest_offsets)
    for joint, parent in enumerate(recording.parents):
        if parent >= 0:
            rest[joint] = rest[parent] + recording.rest_offsets[joint]
    theirs = {j: torch.from_numpy(rest[recording.joint(n)]) for j, n in skeleton.positions}
    ours = body.joint_template.double()
    shared = sorted(set(theirs) - set(FEET))
    a = torch.stack([ours[j] for j in shared])
    b = torch.stack([theirs[j] for j in shared])
    turn = so3.nearest((b - b.mean(0)).mT @ (a - a.mean(0)))
    swings: dict[int, Tensor] = {}
    for joint, child in _CHILD.items():
        if joint not in theirs or child not in theirs:
            return None
        swing = so3.between(turn @ (ours[child] - ours[joint]), theirs[child] - theirs[joint])
        if float(torch.rad2deg(so3.log(swing).norm())) > _WORST_BONE:
            return None
        swings[joint] = swing
    for side in ("left", "right"):
        swings[joint_index(f"{side}_wrist")] = swings[joint_index(f"{side}_elbow")]
    identity = torch.eye(3, dtype=torch.float64)
    return torch.stack([swings.get(j, identity) @ turn for j in skeleton.bones]).float()
