"""The 22 body joints of SMPL: names, tree, groups. The only place with joint numbers."""

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
    """Return the number of a joint, by its name, in the order of `JOINTS`.

    Raises:
        ValueError: when there is no such joint; the message lists them.
    """
    if name not in JOINTS:
        raise ReconError(f"no joint is called {name!r}; the joints are {', '.join(JOINTS)}")
    return JOINTS.index(name)


def descendants(joint: int) -> tuple[int, ...]:
    """Return the numbers of a joint and of all joints below it in the kinematic tree."""
    chain = [joint]
    for child, parent in enumerate(PARENTS):
        if parent in chain and child not in chain:
            chain.append(child)
    return tuple(sorted(chain))
