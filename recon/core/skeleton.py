"""The 22 body joints of SMPL: names, tree, groups. The only place with joint numbers."""

from collections.abc import Mapping
from types import MappingProxyType

from recon.core.errors import ReconError

JOINTS = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist",
)  # fmt: skip
"""SMPL order. `left_foot` is the toe joint, `left_ankle` the ankle, `spine1` the lowest spine."""

PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
"""Index of every joint's parent; the pelvis has none."""

FAMILIES: tuple[tuple[slice, slice | int], ...] = (
    (slice(1, 4), 0),
    (slice(4, 7), slice(1, 4)),
    (slice(7, 10), slice(4, 7)),
    (slice(10, 12), slice(7, 9)),
    (slice(12, 15), 9),
    (slice(15, 18), slice(12, 15)),
    (slice(18, 20), slice(16, 18)),
    (slice(20, 22), slice(18, 20)),
)
"""The tree from the root outwards: runs of children with a parent each, or with one in common."""

CONTACT_JOINTS = (0, 4, 5, 7, 8, 10, 11, 20, 21)
"""Joints that may carry weight: pelvis, knees, ankles, toes, wrists (HuMoR's nine channels)."""

FEET = (7, 8, 10, 11)
"""Ankles and toes."""

TOES = (10, 11)
KNEES = (4, 5)
LEGS = (4, 5, 7, 8, 10, 11)
ARMS = (16, 17, 18, 19, 20, 21)
UPPER = (12, 13, 14, 15, *ARMS)
"""Neck, collars, head and arms."""
MIRROR = (0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20)
"""Index of every joint's counterpart on the other side of the body."""


def joint_index(name: str) -> int:
    """Number of a joint.

    Raises:
        ValueError: when there is no such joint; the message lists them.
    """
    if name not in JOINTS:
        raise ReconError(f"no joint is called {name!r}; the joints are {', '.join(JOINTS)}")
    return JOINTS.index(name)


def descendants(joint: int) -> tuple[int, ...]:
    """The joint and all that hang from it."""
    chain = [joint]
    for child, parent in enumerate(PARENTS):
        if parent in chain and child not in chain:
            chain.append(child)
    return tuple(sorted(chain))


def _pairs(*names: str) -> tuple[str, ...]:
    """left_a, right_a, left_b, right_b, ..."""
    return tuple(f"{side}_{name}" for name in names for side in ("left", "right"))


def _side(side: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for name in names)


_COCO = (
    "nose", *_pairs("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle"),
)  # fmt: skip
_FOOT = ("big_toe", "small_toe", "heel")
JOINT = "_joint"
"""Ending of keypoints that are joints of the body model where detectors mean another place."""


def _arm(side: str) -> tuple[str, ...]:
    names = ("clavicle", "shoulder", "elbow", "wrist", "hand", "fingertip", "thumb")
    return _side(side, *names)


def _leg(side: str) -> tuple[str, ...]:
    return _side(side, "hip", "knee", "ankle", f"foot{JOINT}")


_AZURE = (
    f"pelvis{JOINT}", "spine_navel", "spine_chest", f"neck{JOINT}",
    *_arm("left"), *_arm("right"), *_leg("left"), *_leg("right"),
    f"head{JOINT}", "nose", "left_eye", "left_ear", "right_eye", "right_ear",
)  # fmt: skip
LAYOUTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "openpose25": (
            "nose", "neck", *_side("right", "shoulder", "elbow", "wrist"),
            *_side("left", "shoulder", "elbow", "wrist"), "mid_hip",
            *_side("right", "hip", "knee", "ankle"), *_side("left", "hip", "knee", "ankle"),
            "right_eye", "left_eye", "right_ear", "left_ear",
            *_side("left", *_FOOT), *_side("right", *_FOOT),
        ),
        "openpose25b": (
            *_COCO, "upper_neck", "head_top", *_side("left", *_FOOT), *_side("right", *_FOOT),
        ),
        "coco17": _COCO,
        "coco133": (*_COCO, *_side("left", *_FOOT), *_side("right", *_FOOT)),
        "halpe26": (*_COCO, "head_top", "neck", "mid_hip", *_pairs(*_FOOT)),
        "mediapipe33": (
            "nose", *_side("left", "eye_inner", "eye", "eye_outer"),
            *_side("right", "eye_inner", "eye", "eye_outer"), *_pairs("ear", "mouth"),
            *_pairs("shoulder", "elbow", "wrist", "pinky", "index", "thumb"),
            *_pairs("hip", "knee", "ankle", "heel", "big_toe"),
        ),
        "h36m17": (
            "mid_hip", *_side("right", "hip", "knee", "ankle"),
            *_side("left", "hip", "knee", "ankle"), "spine", "thorax", "nose",
            "head_top", *_side("left", "shoulder", "elbow", "wrist"),
            *_side("right", "shoulder", "elbow", "wrist"),
        ),
        "azure32": _AZURE,
        "zed34": (*_AZURE, *_pairs("heel")),
        "kinect25": (
            f"pelvis{JOINT}", f"spine2{JOINT}", f"neck{JOINT}", "head_centre",
            *_side("left", "shoulder", "elbow", "wrist", "hand"),
            *_side("right", "shoulder", "elbow", "wrist", "hand"),
            *_leg("left"), *_leg("right"), "thorax",
            *_side("left", "fingertip", "thumb"), *_side("right", "fingertip", "thumb"),
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
