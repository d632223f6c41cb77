"""Names unnamed keypoints where their number or their program determines the layout."""

from dataclasses import replace

from recon.core.fingers import FINGER_POINTS
from recon.core.layouts import LAYOUTS, left_right_pairs
from recon.keypoints3d.records import Points3D


def _hand_keypoints(side: str) -> tuple[str, ...]:
    fingers = ("thumb", "index", "middle", "ring", "pinky")
    return tuple(f"{side}_{one}{place}" for one in fingers for place in ("_tip", "3", "2", "1"))


_FOOT = ("big_toe", "small_toe", "heel")
MHR70 = (
    "nose", *left_right_pairs("eye", "ear", "shoulder", "elbow", "hip", "knee", "ankle"),
    *(f"left_{name}" for name in _FOOT), *(f"right_{name}" for name in _FOOT),
    *_hand_keypoints("right"), "right_wrist", *_hand_keypoints("left"), "left_wrist",
    *left_right_pairs("olecranon", "cubital_fossa", "acromion"), "neck",
)  # fmt: skip
"""Names of the keypoints (sam_3d_body/metadata/mhr70.py); of a finger first the tip."""
ZED38 = (
    "pelvis", "spine_1", "spine_2", "spine_3", "neck", "nose",
    *left_right_pairs(
        "eye", "ear", "clavicle", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "big_toe",
        "small_toe", "heel", "thumb_tip", "index", "fingertip", "pinky",
    ),
)  # fmt: skip
"""Names of `sl.BODY_38_PARTS` of Stereolabs' ZED SDK."""
_COCO18 = tuple(LAYOUTS["openpose25"][k] for k in (*range(8), *range(9, 19)))
_LABELS = {18: _COCO18, 38: ZED38, 70: MHR70}
_WHOLE = {133: ("coco133", 91), 136: ("halpe26", 94), 75: ("mediapipe33", 33)}
"""Layout at the head of COCO-WholeBody, HALPE with faces and hands, and MediaPipe with hands, and
the place from which on the 21 points of the left and of the right hand follow."""
_PROGRAMS = {18: "OpenPose's COCO model", 38: "ZED's BODY_38", 70: "MHR70"}
KNOWN_BY_COUNT = _PROGRAMS | {
    count: f"{layout} with hands" for count, (layout, _) in _WHOLE.items()
}
"""Which points unnamed arrays have, by their number, where it is not that of a layout."""


def named_by_count(points: Points3D) -> Points3D:
    """Name unnamed keypoints if their number determines the layout; leave out faces."""
    count = points.positions.shape[1]
    if points.names or points.layout:
        return points
    if count in _WHOLE:
        layout, hands = _WHOLE[count]
        kept = len(LAYOUTS[layout])
        said = f"the first {kept} of {count} points are the body's, from {hands} on those of hands"
        rows = [*range(kept), *range(hands, hands + len(FINGER_POINTS))]
        return replace(
            points, positions=points.positions[:, rows], decisions=(*points.decisions, said),
            names=(*LAYOUTS[layout], *FINGER_POINTS),
        )  # fmt: skip
    if count not in _LABELS:
        return points
    said = f"{count} points are in the order of {_PROGRAMS[count]}"
    return replace(points, names=_LABELS[count], decisions=(*points.decisions, said))
