"""The skeleton of the bundled body: joint names, tree and left-right pairs.

It repeats `recon.core.skeleton` on purpose: the build runs in an environment of its own (with
`anny`) and the asset names its joints, so that a change there cannot silently re-label a built
body.
"""

import numpy as np

JOINTS: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist",
)  # fmt: skip
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
KNUCKLES = tuple(
    f"{s}_{f}_knuckle" for s in ("left", "right") for f in ("index", "middle", "pinky")
)
"""Helper points that orient the hand; not joints of the result."""
POINTS = JOINTS + KNUCKLES
TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")
SIDES = (("L", "left", 1.0), ("R", "right", -1.0))
"""Of each side: MakeHuman's suffix, our prefix, sign of x (x points to the body's left)."""
FLIP = np.array([-1.0, 1.0, 1.0])
"""Factors of coordinates that reflect a point in the median plane."""


def number(name: str) -> int:
    """Return the index of a joint or helper point in `POINTS`."""
    return POINTS.index(name)


def opposite(name: str) -> str:
    """Return the same joint of the other side of the body; for trunk joints, the joint itself."""
    if name.startswith("left_"):
        return "right_" + name.removeprefix("left_")
    if name.startswith("right_"):
        return "left_" + name.removeprefix("right_")
    return name


def mirrored(names: tuple[str, ...]) -> np.ndarray:
    """Return the permutation of joints that exchanges left and right."""
    return np.array([names.index(opposite(name)) for name in names])
