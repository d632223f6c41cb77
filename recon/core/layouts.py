"""Keypoints of detectors: their names and orders, called layouts."""

from collections.abc import Mapping
from types import MappingProxyType

from recon.core.errors import ReconError
from recon.core.skeleton import JOINTS


def left_right_pairs(*names: str) -> tuple[str, ...]:
    """Return each name with the prefixes left_ and right_: left_a, right_a, left_b, ..."""
    return tuple(f"{side}_{name}" for name in names for side in ("left", "right"))


def _on_side(side: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for name in names)


_COCO = (
    "nose", *left_right_pairs("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle"),
)  # fmt: skip
_FOOT = ("big_toe", "small_toe", "heel")
JOINT = "_joint"
"""Ending of keypoints that are joints of the body model where detectors mean another place."""


def _arm_names(side: str) -> tuple[str, ...]:
    names = ("clavicle", "shoulder", "elbow", "wrist", "hand", "fingertip", "thumb")
    return _on_side(side, *names)


def _leg_names(side: str) -> tuple[str, ...]:
    return _on_side(side, "hip", "knee", "ankle", f"foot{JOINT}")


_AZURE = (
    f"pelvis{JOINT}", "spine_navel", "spine_chest", f"neck{JOINT}",
    *_arm_names("left"), *_arm_names("right"), *_leg_names("left"), *_leg_names("right"),
    f"head{JOINT}", "nose", "left_eye", "left_ear", "right_eye", "right_ear",
)  # fmt: skip
LAYOUTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "openpose25": (
            "nose", "neck", *_on_side("right", "shoulder", "elbow", "wrist"),
            *_on_side("left", "shoulder", "elbow", "wrist"), "mid_hip",
            *_on_side("right", "hip", "knee", "ankle"), *_on_side("left", "hip", "knee", "ankle"),
            "right_eye", "left_eye", "right_ear", "left_ear",
            *_on_side("left", *_FOOT), *_on_side("right", *_FOOT),
        ),
        "openpose25b": (
            *_COCO, "upper_neck", "head_top",
            *_on_side("left", *_FOOT), *_on_side("right", *_FOOT),
        ),
        "coco17": _COCO,
        "coco133": (*_COCO, *_on_side("left", *_FOOT), *_on_side("right", *_FOOT)),
        "halpe26": (*_COCO, "head_top", "neck", "mid_hip", *left_right_pairs(*_FOOT)),
        "mediapipe33": (
            "nose", *_on_side("left", "eye_inner", "eye", "eye_outer"),
            *_on_side("right", "eye_inner", "eye", "eye_outer"), *left_right_pairs("ear", "mouth"),
            *left_right_pairs("shoulder", "elbow", "wrist", "pinky", "index", "thumb"),
            *left_right_pairs("hip", "knee", "ankle", "heel", "big_toe"),
        ),
        "h36m17": (
            "mid_hip", *_on_side("right", "hip", "knee", "ankle"),
            *_on_side("left", "hip", "knee", "ankle"), "spine", "thorax", "nose",
            "head_top", *_on_side("left", "shoulder", "elbow", "wrist"),
            *_on_side("right", "shoulder", "elbow", "wrist"),
        ),
        "azure32": _AZURE,
        "zed34": (*_AZURE, *left_right_pairs("heel")),
        "kinect25": (
            f"pelvis{JOINT}", f"spine2{JOINT}", f"neck{JOINT}", "head_centre",
            *_on_side("left", "shoulder", "elbow", "wrist", "hand"),
            *_on_side("right", "shoulder", "elbow", "wrist", "hand"),
            *_leg_names("left"), *_leg_names("right"), "thorax",
            *_on_side("left", "fingertip", "thumb"), *_on_side("right", "fingertip", "thumb"),
        ),
        "smpl22": JOINTS,
    }
)  # fmt: skip
"""Names of the keypoints of every layout. `coco133` is its body part, the first 23 of 133.

`azure32` is the Azure Kinect's skeleton in the order of `k4abt_joint_id_t` (azure-kinect body
tracking SDK, body tracking joints), whose neck, head and feet are joints inside the body;
`kinect25` is that of Kinect v2 in the order of `JointType`, whose head is its middle. `zed34` is
`azure32` with heels.
"""


def keypoint_names(layout: str) -> tuple[str, ...]:
    """The keypoints of a layout, in order.

    Raises:
        ValueError: when there is no such layout.
    """
    try:
        return LAYOUTS[layout]
    except KeyError:
        raise ReconError(f"no layout {layout!r}; there are {', '.join(LAYOUTS)}") from None
