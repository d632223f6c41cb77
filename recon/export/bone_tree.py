"""Finds the bones of a character by branches and positions of its nodes, not by names."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Tree:
    """The tree of nodes in a glTF file, and which of them skins use as joints."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    """Parent of every node, -1 for a root."""
    joints: frozenset[int]
    """Nodes that skins use as joints."""

    def path_to_root(self, node: int) -> list[int]:
        """Return a node and its ancestors, up to the root."""
        found = [node]
        while (parent := self.parents[found[-1]]) >= 0:
            found.append(parent)
        return found

    def lowest_common_ancestor(self, nodes: Sequence[int]) -> int:
        """Return the lowest common ancestor of nodes, maybe one of them; -1 if there is none."""
        first, *others = (self.path_to_root(node) for node in nodes)
        rest = [set(one) for one in others]
        return next((one for one in first if all(one in above for above in rest)), -1)

    def path_below(self, top: int, node: int) -> list[int]:
        """Return the path from a child of `top` down to `node`; empty unless below `top`."""
        path = self.path_to_root(node)
        return path[: path.index(top)][::-1] if top in path else []


def bones_by_tree(tree: Tree, places: Float[np.ndarray, "nodes 3"]) -> dict[str, int]:
    """Find bones by branches and positions: two legs down, two arms aside, a head above.

    Hips are the joint below which two limbs reach the ground, the chest that from which two reach
    farthest aside. Toes show the front; where there are none it is +z, as in glTF.
    """
    joints = sorted(tree.joints)
    children: dict[int, list[int]] = {k: [] for k in joints}
    for k in joints:
        if tree.parents[k] in children:
            children[tree.parents[k]].append(k)
    leaves = [k for k in joints if not children[k]]
    if len(leaves) < 5:
        return {}
    high = places[leaves, 1]
    reach = np.ptp(places[joints, 1])
    low = [k for k, y in zip(leaves, high, strict=True) if y <= high.min() + 0.12 * reach]
    hips = tree.lowest_common_ancestor(low)
    branches = [
        [k for k in low if child in tree.path_to_root(k)] for child in children.get(hips, ())
    ]
    feet = [max(ends, key=lambda k: len(tree.path_to_root(k))) for ends in branches if ends]
    if len(feet) != 2:
        return {}
    legs = [[k for k in tree.path_below(hips, foot) if k in tree.joints] for foot in feet]
    rest = [k for k in leaves if k not in low]
    aside = places[feet[0]] - places[feet[1]]
    aside = aside / max(float(np.linalg.norm(aside)), 1e-9)
    spread = (places[rest] - places[hips]) @ aside
    arms = [rest[int(spread.argmax())], rest[int(spread.argmin())]] if rest else []
    middle = [k for k in rest if abs((places[k] - places[hips]) @ aside) < 0.06 * reach]
    if len(arms) < 2 or arms[0] == arms[1] or not middle:
        return {}
    top = max(middle, key=lambda k: places[k, 1])
    chest = tree.lowest_common_ancestor(arms)
    found: dict[str, int] = {}
    head = tree.path_below(chest, top)
    if not head:
        return {}
    # of three or more bones above the chest, the last is the tip of the head, not its joint
    found["head"] = head[-2] if len(head) > 2 else head[-1]
    chains = [_leg_joints(legs[0], places), _leg_joints(legs[1], places)]
    ahead = sum((places[one[3]] - places[one[2]] for one in chains if len(one) > 3), np.zeros(3))
    if np.linalg.norm(ahead[[0, 2]]) < 1e-3 * reach:
        ahead = np.array([0.0, 0.0, 1.0])
    left = np.cross([0.0, 1.0, 0.0], ahead)
    for number, chain in enumerate(chains):
        side = "left" if (left @ aside > 0) == (number == 0) else "right"
        found |= dict(zip([f"{side}_{j}" for j in ("hip", "knee", "ankle", "foot")], chain,
                          strict=False)) if len(chain) > 2 else {}  # fmt: skip
        arm = _arm_joints(tree, tree.path_below(chest, arms[number]), children, places)
        names = [f"{side}_{j}" for j in ("collar", "shoulder", "elbow", "wrist")]
        found |= {name: node for name, node in zip(names, arm, strict=False) if node >= 0}
    return found


def _leg_joints(chain: list[int], places: Float[np.ndarray, "nodes 3"]) -> list[int]:
    """Choose hip, knee, ankle and maybe toes in a chain of nodes; none if it is too short."""
    if len(chain) < 3:
        return []
    heights = places[chain, 1] - places[chain[-1], 1]
    low = [k for k in range(2, len(chain)) if heights[k] < 0.25 * heights[0]]
    ankle = low[0] if low else len(chain) - 1
    half = 0.5 * (heights[0] + heights[ankle])
    knee = min(range(1, ankle), key=lambda k: abs(heights[k] - half))
    toes = [chain[ankle + 1]] if ankle + 1 < len(chain) else []
    return [chain[0], chain[knee], chain[ankle], *toes]


def _arm_joints(
    tree: Tree,
    chain: list[int],
    children: Mapping[int, list[int]],
    places: Float[np.ndarray, "nodes 3"],
) -> list[int]:
    """Choose collar (-1 for none), shoulder, elbow and wrist in a chain from chest to tip."""
    chain = [k for k in chain if k in tree.joints]
    fork = [k for k, node in enumerate(chain) if len(children[node]) > 2]
    end = fork[0] if fork else len(chain) - 1
    if end < 2:
        return []
    along = np.r_[0, np.linalg.norm(np.diff(places[chain], axis=0), axis=-1).cumsum()]

    def unevenness_and_elbow(first: int) -> tuple[float, int]:
        half = 0.5 * (along[first] + along[end])
        elbow = min(range(first + 1, end), key=lambda k: abs(along[k] - half))
        return abs(float(along[elbow] - half) / (along[end] - along[first])), elbow

    # the chain begins with a collar bone if upper arm and forearm are then more equal in length
    first = int(end > 2 and unevenness_and_elbow(1)[0] < unevenness_and_elbow(0)[0])
    elbow = unevenness_and_elbow(first)[1]
    return [chain[0] if first else -1, chain[first], chain[elbow], chain[end]]
