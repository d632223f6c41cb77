"""The joint tree says the same in every form it is kept in."""

import pytest

from recon.core.skeleton import FAMILIES, JOINTS, MIRROR, PARENTS, descendants, joint_index


def test_families_are_the_tree():
    parents = {0: -1}
    for children, above in FAMILIES:
        numbers = range(22)[children]
        row = [above] * len(numbers) if isinstance(above, int) else list(range(22)[above])
        assert all(parent in parents for parent in row)  # roots before leaves
        parents |= dict(zip(numbers, row, strict=True))
    assert tuple(parents[joint] for joint in range(22)) == PARENTS


def test_mirror_swaps_names_and_keeps_the_tree():
    for joint, other in enumerate(MIRROR):
        swapped = JOINTS[joint].replace("left", "?").replace("right", "left").replace("?", "right")
        assert JOINTS[other] == swapped
        assert MIRROR[other] == joint
        assert joint == 0 or PARENTS[other] == MIRROR[PARENTS[joint]]


def test_joints_by_name():
    assert joint_index("left_foot") == 10
    assert descendants(joint_index("left_knee")) == (4, 7, 10)
    with pytest.raises(ValueError, match="left_wrist"):
        joint_index("left_hand")
