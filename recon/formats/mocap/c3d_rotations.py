"""Poses of segments in a C3D file without points (group ROTATION): their joint centres.

Theia3D writes such files, with one 4 x 4 matrix per segment (labels pelvis_4X4, l_thigh_4X4, ...)
whose origin is the joint at the segment's upper end. Each matrix is stored column by column, with
its translation last, and a seventeenth number, negative where nothing was seen (C3D's extension
for rotations; ezc3d reads the same). Tested on one file, the example that ezc3d reads.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import JOINTS, SAMPLES
from recon.formats.mocap.recording import MarkerRecording

_NUMBERS = 17
"""Numbers per segment and frame: a matrix and its reliability."""
_ORIGINS = {
    "thigh": "hip", "shank": "knee", "foot": "ankle", "toes": "foot", "uarm": "shoulder",
    "larm": "elbow", "hand": "wrist",
}  # fmt: skip
"""The joint at the origin of every segment that has one."""
_SIDES = {"l": "left", "r": "right"}
_ENDING = "_4x4"


def joint_centres(
    values: Float[np.ndarray, " numbers"],
    labels: Sequence[str],
    frames: int,
    path: Path,
    fps: float,
) -> MarkerRecording:
    """Joint centres, named left_hip, right_knee, ..., in the file's unit and axes.

    Args:
        values: numbers from the beginning of the data on.
        labels: of the segments, in their order.
        frames: how many there are.
        path: for messages.
        fps: frames per second.

    Raises:
        ValueError: when the data is cut short, or its segments are not known.
    """
    JOINTS.check(len(labels), path, "ROTATION:LABELS")
    SAMPLES.check(max(0, frames) * len(labels), path, "header")
    count = frames * len(labels) * _NUMBERS
    if frames < 1 or not labels or len(values) < count:
        raise FormatError(
            f"{path}: a C3D file of rotations promises {frames} frames of {len(labels)} segments, "
            f"{count} numbers in all; the file has {len(values)} and is cut short or damaged"
        )
    table = values[:count].reshape(frames, len(labels), _NUMBERS)
    joints = {k: name for k, label in enumerate(labels) if (name := _joint(label)) is not None}
    if len(joints) < len(_ORIGINS):
        raise FormatError(
            f"{path}: its points are poses of segments (group ROTATION), of which "
            f"{len(joints)} are known ({', '.join(labels[:8])}, ...); expected l_thigh_4X4, "
            "r_shank_4X4, ... as Theia3D writes them, or points"
        )
    origins = table[:, list(joints), 12:15]
    visible = np.isfinite(table[:, list(joints)]).all(-1) & (table[:, list(joints), 16] >= 0)
    visible &= (origins != 0).any(-1)
    used = [labels[k] for k in joints]
    left = [label for label in labels if label not in used]
    return MarkerRecording(
        name=path.name,
        marker_names=tuple(joints.values()),
        positions=np.where(visible[..., None], origins, 0.0),
        visible=visible,
        fps=fps,
        decisions=(
            f"{fps:g} frames per second: stated by the file",
            f"no points but poses of segments (group ROTATION): the origins of {len(used)} are "
            f"joint centres; left out: {', '.join(left) or 'none'}, and all rotations",
        ),
    )


def _joint(label: str) -> str | None:
    """left_hip of l_thigh_4X4; None for segments whose origin is no joint of ours."""
    side, _, segment = label.lower().removesuffix(_ENDING).partition("_")
    if side not in _SIDES or segment not in _ORIGINS:
        return None
    return f"{_SIDES[side]}_{_ORIGINS[segment]}"
