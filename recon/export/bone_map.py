"""Finds the bones of a character that stand for body joints, by VRM's table, names or tree."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.core.bone_names import FINGER_WORDS, LIMBS, names_of_joints, side_and_words_of
from recon.core.errors import ReconError
from recon.core.fingers import FINGERS, HAND_JOINTS, SIDES
from recon.core.skeleton import JOINTS
from recon.export.bone_tree import Tree, bones_by_tree
from recon.formats.texts import read_toml

_NEEDED = tuple(
    f"{side}_{name}" for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in SIDES
)  # fmt: skip
_HELPER_WORDS = frozenset((
    "ik", "fk", "pole", "ctrl", "control", "mch", "target", "end", "twist", "roll", "helper",
    "nub", "tip", "adj", "tweak", "socket", "prop", "weapon", "dyn", "jiggle", "eff", "effector",
))  # fmt: skip
"""Words in names of helper bones, such as IK targets and twist bones, which are no joints."""
_METACARPALS = frozenset(("metacarpal", "meta", "mc", "palm"))
_CLAVICLES = ("shoulder", "clavicle", "collar", "clav", "scapula")


@dataclass(frozen=True)
class BoneMap:
    """The nodes of a character that stand for a person's joints."""

    nodes: Mapping[str, int]
    """Node of each body joint but those of spine and neck; fingers and toes may be missing."""
    spine: tuple[int, ...]
    """Nodes of the spine, from the one above the hips to the one that bears the arms."""
    neck: tuple[int, ...]
    """Nodes of the neck, between spine and head."""
    by_tree: tuple[str, ...]
    """Joints whose bones were found by the branches of the tree, as names told nothing."""

    def names_by_joint(self, names: Sequence[str]) -> dict[str, str]:
        """Return the names of the nodes, keyed by joint."""
        chains = {"spine": self.spine, "neck": self.neck}
        joined = {name: ", ".join(names[k] for k in chain) for name, chain in chains.items()}
        return {name: names[node] for name, node in self.nodes.items()} | {
            name: nodes for name, nodes in joined.items() if nodes
        }


def map_bones(
    tree: Tree,
    places: Float[np.ndarray, "nodes 3"],
    document: Mapping[str, Any],
    path: Path,
    table: Path | None = None,
) -> BoneMap:
    """Find the nodes of a character that stand for a person's joints.

    A file of the user has precedence over VRM's table, that over names, and names over the tree.
    Hips are the lowest node above thighs and head, the spine leads from there to the node above
    both arms.

    Args:
        tree: names and parents of the nodes.
        places: positions of the nodes in the character's rest pose, y up.
        document: the glTF file's JSON.
        path: of the file, for messages.
        table: TOML file of lines `left_knee = "name of a node"`, with recon's names of joints.

    Raises:
        ReconError: when bones are missing or two are the same; the message has their names.
    """
    found, by_tree = (
        _vrm_bones(document, len(tree.names)) or _bones_by_names(tree, path),
        list[str](),
    )
    found |= _bones_of_user(table, tree) if table is not None else {}
    missing = [joint for joint in (*_NEEDED, "head") if joint not in found]
    if missing:
        guessed = bones_by_tree(tree, places)
        for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "foot")):
            for side in SIDES:
                names = [f"{side}_{joint}" for joint in limb]
                if any(name in missing for name in names) and names[0] in guessed:
                    chosen = {name: guessed[name] for name in names if name in guessed}
                    by_tree += [name for name in chosen if name not in found]
                    found |= {
                        name: node
                        for name, node in chosen.items()
                        if name in missing or (name == names[-1] and name not in found)
                    }
        if "head" not in found and "head" in guessed:
            found["head"] = guessed["head"]
            by_tree.append("head")
    lacking = [joint for joint in (*_NEEDED, "head") if joint not in found]
    if lacking:
        raise ReconError(
            f"{path}: no bones were found for {', '.join(lacking)}. Name them in a file for "
            f'--bones, as left_knee = "bone"; its bones are {_listed_bone_names(tree)}'
        )
    return _completed_map(tree, found, tuple(by_tree), path)


def _listed_bone_names(tree: Tree) -> str:
    names = [tree.names[k] for k in sorted(tree.joints)]
    more = f" and {len(names) - 60} more" if len(names) > 60 else ""
    return ", ".join(f"{name!r:.40}" for name in names[:60]) + more


def _completed_map(
    tree: Tree, found: dict[str, int], by_tree: tuple[str, ...], path: Path
) -> BoneMap:
    """Add hips, spine, neck and collars, which lie between the bones that were found.

    Raises:
        ReconError: when the bones are not connected as in a body.
    """
    legs, arms = ([found[f"{s}_{joint}"] for s in SIDES] for joint in ("hip", "shoulder"))
    hips = found.get("pelvis", tree.lowest_common_ancestor([*legs, found["head"]]))
    chest = tree.lowest_common_ancestor(arms)
    neck_base = tree.lowest_common_ancestor([*arms, found["head"]])
    spine = tree.path_below(hips, chest) if hips >= 0 else []
    needed = {"pelvis": hips, "the node above both arms": chest}
    if not spine or neck_base < 0:
        lost = [name for name, node in needed.items() if node < 0] or ["spine"]
        raise ReconError(
            f"{path}: {', '.join(lost)} not found: expected a node above both thighs and the "
            "head, and below it one above both arms. Are these two characters, or parts without "
            'a common root? Name bones in a file for --bones, as pelvis = "bone"'
        )
    nodes: dict[str, int] = {"pelvis": hips, **found}
    for side, arm in zip(SIDES, arms, strict=True):
        between = tree.path_below(chest, arm)[:-1]
        named = [k for k in between if any(word in tree.names[k].lower() for word in _CLAVICLES)]
        if between and f"{side}_collar" not in nodes:
            nodes[f"{side}_collar"] = (named or between)[-1]
    chain = [*_NEEDED, "head", "pelvis"]
    for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")):
        for side in SIDES:
            for above, below in pairwise(limb):
                a, b = nodes[f"{side}_{above}"], nodes[f"{side}_{below}"]
                if not tree.path_below(a, b):
                    raise ReconError(
                        f"{path}: {side}_{below} is {tree.names[b]!r:.40}, which does not lie "
                        f"below {tree.names[a]!r:.40}, the {side}_{above}. Name the right bones "
                        "in a file for --bones"
                    )
    for side in SIDES:
        toes = f"{side}_foot"
        if toes in nodes and not tree.path_below(nodes[f"{side}_ankle"], nodes[toes]):
            del nodes[toes]
    used = [nodes[name] for name in chain]
    if len(set(used)) < len(used):
        twice = next(tree.names[k] for k in used if used.count(k) > 1)
        raise ReconError(
            f"{path}: expected one bone per joint, but {twice!r:.40} would be several joints; "
            "name the right bones in a file for --bones"
        )
    top = neck_base if neck_base in spine else chest
    neck = tuple(tree.path_below(top, nodes["head"])[:-1])
    chains = {"spine1", "spine2", "spine3", "neck"}
    kept = {
        joint: nodes[joint]
        for joint in (*JOINTS, *HAND_JOINTS)
        if joint in nodes and joint not in chains
    }
    return BoneMap(kept, tuple(spine), neck, by_tree)


def _bones_of_user(table: Path, tree: Tree) -> dict[str, int]:
    """Read the file in which the user named bones; return their nodes, keyed by joint.

    Raises:
        ReconError: when a name is no joint, or not the name of exactly one node.
    """
    found, known = {}, (*JOINTS, *HAND_JOINTS)
    for joint, name in read_toml(table).items():
        if joint not in known or joint in ("spine1", "spine2", "spine3", "neck"):
            raise ReconError(
                f"{table}: expected names of joints such as left_knee or right_index1 (spine and "
                f"neck are found by themselves, between pelvis and head), got {joint!r:.40}"
            )
        nodes = [k for k, own in enumerate(tree.names) if own == name]
        if len(nodes) != 1:
            count = "no node" if not nodes else f"{len(nodes)} nodes"
            raise ReconError(
                f"{table}: {joint} = {name!r:.40}, but {count} of the character has this name; "
                f"its bones are {_listed_bone_names(tree)}"
            )
        found[joint] = nodes[0]
    return found


def _vrm_bones(document: Mapping[str, Any], count: int) -> dict[str, int]:
    """Read the bones from the table of a VRM 1.0 or 0.x; empty for other files."""
    extensions = document.get("extensions")
    extensions = extensions if isinstance(extensions, dict) else {}
    known = {bone: joint for joint, bone in names_of_joints()["vrm"].items()}
    rows: list[tuple[Any, Any]] = []
    for key, old in (("VRMC_vrm", False), ("VRM", True)):
        entry = extensions.get(key)
        entry = entry.get("humanoid") if isinstance(entry, dict) else None
        entry = entry.get("humanBones") if isinstance(entry, dict) else None
        if isinstance(entry, dict):
            rows = [(k, one.get("node")) for k, one in entry.items() if isinstance(one, dict)]
        elif old and isinstance(entry, list):
            rows = [(one.get("bone"), one.get("node")) for one in entry if isinstance(one, dict)]
            # VRM 0.x names the thumb's first two joints otherwise than VRM 1.0
            for side in SIDES:
                known[f"{side}ThumbProximal"] = f"{side}_thumb1"
                known[f"{side}ThumbIntermediate"] = f"{side}_thumb2"
        if rows:
            break
    chains = ("spine1", "spine2", "spine3", "neck")
    return {
        known[name]: node for name, node in rows
        if name in known and known[name] not in chains and type(node) is int and 0 <= node < count
    }  # fmt: skip


def _bones_by_names(tree: Tree, path: Path) -> dict[str, int]:
    """Find bones by their names; return nodes, keyed by joint.

    Raises:
        ReconError: when the names of two bones mean the same joint.
    """
    side_and_words = {k: side_and_words_of(tree.names[k]) for k in sorted(tree.joints)}
    side_and_words = {
        k: one for k, one in side_and_words.items() if not _HELPER_WORDS & set(one[1])
    }
    candidates: dict[str, list[tuple[int, int, int]]] = {}
    for node, (side, words) in side_and_words.items():
        trailing = 0
        while words and words[-1].lstrip("0") == "1":
            words, trailing = words[:-1], trailing + 1
        for cut in range(min(len(words), 4)):
            key = "".join(words[cut:])
            if key == "head" and not side:
                candidates.setdefault("head", []).append((cut + trailing, 0, node))
            for joint, keys in LIMBS.items() if side else ():
                if key in keys:
                    row = (cut + trailing, keys.index(key), node)
                    candidates.setdefault(f"{side}_{joint}", []).append(row)
    found: dict[str, int] = {}
    numbered = [k for k, (_, words) in side_and_words.items() if words[:-1] == ["spine"]]
    if "head" not in candidates and len(numbered) > 3:
        # Rigify counts neck and head as parts of the spine
        found["head"] = max(numbered, key=lambda k: len(tree.path_to_root(k)))
    # ankles come before toes (joint left_foot): a bone called foot is the toes if it is no ankle
    for joint, rows in sorted(candidates.items(), key=lambda one: one[0].endswith("_foot")):
        free = [row for row in rows if row[2] not in found.values()]
        if not free:
            continue
        best = min(row[:2] for row in free)
        nodes = [node for *how, node in free if tuple(how) == best]
        top = [k for k in nodes if not set(tree.path_to_root(k)[1:]) & set(nodes)]
        if len(top) > 1:
            both = " and ".join(f"{tree.names[k]!r:.40}" for k in top[:2])
            raise ReconError(
                f"{path}: expected one bone for {joint}, but {both} may be it; give one character "
                "at a time, or name the bones in a file for --bones"
            )
        found[joint] = top[0]
    for side in SIDES:
        if f"{side}_wrist" in found:
            found |= _finger_joints(tree, found[f"{side}_wrist"], side, side_and_words)
    return found


def _finger_joints(
    tree: Tree, hand: int, side: str, side_and_words: Mapping[int, tuple[str, list[str]]]
) -> dict[str, int]:
    """Find the finger joints of one hand, by names and by their order along the fingers.

    A finger's bone with the number 0 is a metacarpal if three more follow, else the first joint.
    """
    rows: dict[str, list[tuple[int, int]]] = {finger: [] for finger in FINGERS}
    for node, (_, words) in side_and_words.items():
        if node == hand or not (below := tree.path_below(hand, node)):
            continue
        named = {FINGER_WORDS[word] for word in words if word in FINGER_WORDS}
        if len(named) == 1:
            (finger,) = named
            if finger == "thumb" or not _METACARPALS & set(words):
                rows[finger].append((len(below), node))
    found = {}
    for finger, bones in rows.items():
        chain = [node for _, node in sorted(bones)]
        if finger != "thumb" and len(chain) > 3:
            words = side_and_words[chain[0]][1]
            chain = chain[int(any(not word.strip("0") for word in words)) :]
        found |= {f"{side}_{finger}{k + 1}": node for k, node in enumerate(chain[:3])}
    return found
