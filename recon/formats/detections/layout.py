"""The layout of an array of keypoints: given, by their number, or by the shape of the body."""

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.layouts import LAYOUTS, keypoint_names

_BY_COUNT = {
    17: "coco17", 23: "coco133", 26: "halpe26", 33: "mediapipe33", 133: "coco133", 136: "halpe26"
}  # fmt: skip
"""Detectors of 17 keypoints are COCO's unless told; 133 and 136 add face and hands to a body."""

_BODY_PART = {("coco133", 133): 23, ("halpe26", 136): 26}
"""Keypoints at the head of a longer layout."""

_COCO18 = (*range(8), *range(9, 19))
"""Indices of the keypoints of OpenPose's COCO model in BODY_25, which adds hips and feet."""

_BONES = tuple(
    (f"{side}_{upper}", f"{side}_{lower}")
    for side in ("left", "right")
    for upper, lower in (
        ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
        ("shoulder", "hip"), ("ankle", "heel"), ("eye", "ear"),
    )
)  # fmt: skip
_MIN_BONES = 6
"""Bones a person must show in both readings to have a say."""
_CONFIDENT = 0.3
_SHORTER = 0.75
"""The right reading has bones at most this much of the length of the wrong one's."""
_AGREEMENT = 0.8
"""Share of the people that must agree."""


def settle_layout(
    points: Float[np.ndarray, "rows points 3"], layout: str | None, name: str
) -> tuple[str, Float[np.ndarray, "rows known 3"], str]:
    """The layout, the points in its order, and the reason.

    25 keypoints may be OpenPose's BODY_25 or BODY_25B: read the wrong way, arms and legs join
    points far apart, so the reading in which the bones are shorter is right. 18 are OpenPose's
    COCO model and become `openpose25` without middle of the hips and feet; of 133 and 136 the
    body part is kept.

    Raises:
        ValueError: when the layout has another number of keypoints, or cannot be told.
    """
    count = points.shape[1]
    if layout is not None:
        points = points[:, : _BODY_PART.get((layout, count), count)]
        if layout == "openpose25" and count == len(_COCO18):
            return layout, _from_coco18(points), f"layout {layout}: given, 18 of its keypoints"
        if len(keypoint_names(layout)) != points.shape[1]:
            raise FormatError(
                f"{name}: layout {layout} has {len(keypoint_names(layout))} keypoints, the file "
                f"{count}; give the right one with --layout"
            )
        return layout, points, f"layout {layout}: given"
    if count == len(_COCO18):
        return "openpose25", _from_coco18(points), "layout openpose25: 18 keypoints, COCO model"
    if count == len(LAYOUTS["openpose25"]):
        chosen = _openpose_model(points, name)
        return chosen, points, f"layout {chosen}: 25 keypoints, arms and legs are whole only so"
    if count not in _BY_COUNT:
        raise FormatError(
            f"{name}: {count} keypoints are no layout known here; give one of "
            f"{', '.join(LAYOUTS)} with --layout"
        )
    chosen = _BY_COUNT[count]
    kept = points[:, : _BODY_PART.get((chosen, count), count)]
    return chosen, kept, f"layout {chosen}: {count} keypoints"


def _from_coco18(points: np.ndarray) -> np.ndarray:
    out = np.zeros((len(points), len(LAYOUTS["openpose25"]), 3))
    out[:, list(_COCO18)] = points
    return out


def _openpose_model(points: np.ndarray, name: str) -> str:
    first, second = "openpose25", "openpose25b"
    ratio = _bone_length(points, first) / _bone_length(points, second)
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) > 0:
        if (ratio <= _SHORTER).mean() >= _AGREEMENT:
            return first
        if (ratio >= 1 / _SHORTER).mean() >= _AGREEMENT:
            return second
    raise FormatError(
        f"{name}: 25 keypoints may be OpenPose's BODY_25 or BODY_25B, and "
        + ("nobody is seen well enough to tell" if len(ratio) == 0 else "people fit neither well")
        + f"; give --layout {first} or --layout {second}"
    )


def _bone_length(points: np.ndarray, layout: str) -> np.ndarray:
    """Mean length of the bones seen, pixels, by person; NaN where there are too few."""
    index = {name: k for k, name in enumerate(keypoint_names(layout))}
    pairs = np.array([(index[a], index[b]) for a, b in _BONES])
    seen = (points[:, pairs, 2] >= _CONFIDENT).all(-1)
    ends = points[:, pairs, :2]
    length = np.where(seen, np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1), 0.0)
    count = seen.sum(1)
    enough = (count >= _MIN_BONES) & (length.sum(1) > 0)
    return np.where(enough, length.sum(1) / np.maximum(count, 1), np.nan)
