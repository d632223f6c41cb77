"""Finds recon's joints in a skeleton of unknown names, by its tree of legs, arms and spine."""

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_LEFT, _RIGHT = (
    re.compile(rf"(?i:{word})|(?:^|[\W_\d])[{a}{a.lower()}](?=[A-Z\W_]|$)|(?<=[a-z\d]){a}$")
    for word, a in (("left", "L"), ("right", "R"))
)  # fmt: skip
"""LeftLeg, LThigh, lThigh, Leg.L, thigh_l and ThighL, and the same of the right side."""
_ALIKE = 0.1
"""Share by which lengths of both sides may differ."""
_LONG = 0.3
"""Length of an arm from the chest on, in lengths of a leg, at least."""
_HALVES = (0.75, 1.6)
"""Lengths of upper bones of limbs in lengths of the lower ones."""
_LEG = (1.0, 2.3)
"""Lengths of legs up to the ankles in lengths of arms up to the wrists."""
_PARTS = (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist"))


def joints_by_tree(
    names: Sequence[str], parents: Sequence[int], offsets: Float[np.ndarray, "joints 3"]
) -> dict[str, str] | None:
    """Map recon's joints to a skeleton's joint names; None if its tree is not a person's.

    Legs and arms are the two pairs of similar long branches; legs are longer. Hip, knee and ankle,
    or shoulder, elbow and wrist, are the ends of the two longest consecutive bones of a branch.
    Names are used only to distinguish left from right.

    Args:
        names: of the joints; tips of last bones end in `_end`.
        parents: of the joints, which come before their children; -1 for the root.
        offsets: of the joints in their parents, in any unit.
    """
    lengths = np.linalg.norm(offsets, axis=-1)
    below: list[list[int]] = [[] for _ in names]
    for joint, parent in enumerate(parents[1:], 1):
        below[parent].append(joint)
    longest: list[list[int]] = [[] for _ in names]
    reach = np.zeros(len(names))
    for joint in reversed(range(len(names))):
        first = max(below[joint], key=lambda one: reach[one], default=-1)
        longest[joint] = [joint] if first < 0 else [joint, *longest[first]]
        reach[joint] = lengths[joint] + (0.0 if first < 0 else reach[first])
    limbs = sorted(
        (min(pairs, key=lambda pair: abs(reach[pair[0]] - reach[pair[1]])) for one in below
         if (pairs := [(a, b) for k, a in enumerate(one) for b in one[k + 1 :]])),
        key=lambda pair: -reach[list(pair)].sum(),
    )[:2]  # fmt: skip
    if len(limbs) < 2 or reach[limbs[1][0]] < _LONG * reach[limbs[0][0]]:
        return None
    found: dict[str, str] = {}
    sizes: list[float] = []
    for pair, parts in zip(limbs, _PARTS, strict=True):
        chains = [longest[one] for one in _left_and_right(pair, longest, names)]
        count = min((len(chain) for chain in chains), default=0)
        if count < 3:
            return None
        bones = np.array([lengths[chain[1:count]] for chain in chains])
        halves = np.minimum(bones[:, :-1], bones[:, 1:]).sum(0)
        start = int(np.argmax(halves))
        upper, lower = bones[:, start], bones[:, start + 1]
        alike = np.ptp(upper + lower) <= _ALIKE * (upper + lower).max()
        if not alike or (upper < _HALVES[0] * lower).any() or (upper > _HALVES[1] * lower).any():
            return None
        sizes.append(float((upper + lower).mean()))
        for side, chain in zip(("left", "right"), chains, strict=True):
            joints = [names[k] for k in chain[start:] if not names[k].endswith("_end")]
            found |= {f"{side}_{part}": name for part, name in zip(parts, joints, strict=False)}
            if parts == _PARTS[1] and start > 0:
                found[f"{side}_collar"] = names[chain[start - 1]]
    if not _LEG[0] < sizes[0] / sizes[1] < _LEG[1]:
        return None
    pelvis, chest = (parents[one] for one, _ in limbs)
    if _ancestors(parents, pelvis)[1:].count(chest):
        return None  # no person: arms would be attached below the legs
    upwards = max(set(below[chest]) - set(limbs[1]), key=lambda one: reach[one], default=-1)
    neck = [] if upwards < 0 else longest[upwards]
    return {"pelvis": names[pelvis]} | found | _trunk_joints(names, parents, pelvis, chest, neck)


def _left_and_right(
    pair: tuple[int, int], longest: Sequence[Sequence[int]], names: Sequence[str]
) -> tuple[int, ...]:
    """Return left and right of two branches by joint names; empty if names do not tell."""
    left = [sum(bool(_LEFT.search(names[k])) for k in longest[one]) for one in pair]
    right = [sum(bool(_RIGHT.search(names[k])) for k in longest[one]) for one in pair]
    if left[0] > right[0] and right[1] > left[1]:
        return pair
    return pair[::-1] if left[1] > right[1] and right[0] > left[0] else ()


def _ancestors(parents: Sequence[int], joint: int) -> list[int]:
    """Return the indices of a joint and all its ancestors, up to the root's parent, -1."""
    above = [joint]
    while above[-1] >= 0:
        above.append(parents[above[-1]])
    return above


def _trunk_joints(
    names: Sequence[str], parents: Sequence[int], pelvis: int, chest: int, neck: list[int]
) -> dict[str, str]:
    """Map recon's spine, neck and head to the skeleton's joints, if the tree has them."""
    above = _ancestors(parents, pelvis)
    spine: list[int] = []
    while chest not in above:
        spine, chest = [chest, *spine], parents[chest]
    chosen = [spine[0], spine[len(spine) // 2], spine[-1]] if len(spine) > 2 else spine
    inside = [names[k] for k in neck if not names[k].endswith("_end")]
    head = next((name for name in inside if "head" in name.lower()), inside[-1] if inside else "")
    parts = zip(("spine3", "spine2", "spine1"), reversed(chosen), strict=False)
    return {
        **{part: names[k] for part, k in parts},
        **({"head": head} if head else {}),
        **({"neck": inside[0]} if inside and inside[0] != head else {}),
    }
