"""Recognises keypoints by their labels, however programs spell these."""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from recon.core.bone_names import FINGER_WORDS, LIMBS, side_and_words_of
from recon.core.fingers import FINGER_POINTS, FINGERS, SIDES
from recon.core.layouts import JOINT, LAYOUTS
from recon.core.skeleton import JOINTS
from recon.detections.tables import plain_part_name
from recon.keypoints3d.records import Points3D

_PREFIX = re.compile(r"^(mediapipe_|rtmpose_|yolo_)?(body|pose|joint|kpt|kp)_(?=[a-z])")
_ABBREVIATED = re.compile(
    r"^([lr])_?(hip|knee|ankle|shoulder|elbow|wrist|eye|ear|heel|foot|hand|toe|collar|clavicle"
    r"|big_?toe|small_?toe)$"
)
_SAME = {
    "hip": "mid_hip", "hips": "mid_hip", "pelvis": "mid_hip", "c_hip": "mid_hip",
    "chip": "mid_hip", "root": "mid_hip", "hip_center": "mid_hip", "hips_center": "mid_hip",
    "head": "head_top", "top_head": "head_top", "top_of_head": "head_top", "vertex": "head_top",
    "belly": "spine", "torso": "spine", "neck_nose": "nose", "spine_naval": "spine_navel",
    "spine_base": f"pelvis{JOINT}", "spine_mid": f"spine2{JOINT}", "spine_shoulder": "thorax",
    "chest": "thorax", "neck_base": "neck", "mid_shoulder": "neck",
}  # fmt: skip
_SAME_SIDED = {
    "foot_index": "big_toe", "toe": "big_toe", "toes": "big_toe", "bigtoe": "big_toe",
    "smalltoe": "small_toe", "big_toe_tip": "big_toe", "small_toe_tip": "small_toe",
    "little_toe": "small_toe", "hand_tip": "fingertip",
    "handtip": "fingertip", "collar": "clavicle", "mouth_corner": "mouth",
}  # fmt: skip
_JOINTS_ONLY = (
    "spine1", "spine3", "spine_1", "spine_3", "left_clavicle", "right_clavicle", "spine_navel",
    "spine_chest", "spine_base",
)  # fmt: skip
"""Names that skeletons of joints have and detectors do not."""
STUDY = "_study"
"""Ending of the markers that OpenCap's augmenter adds."""
_CORE = tuple(f"{side}_{name}" for side in ("left", "right") for name in ("hip", "knee", "ankle"))
"""Keypoints that every detector of bodies finds, and whose names together no marker set has."""
_MOST = 0.6
"""Share of the labels that are names of keypoints where a recording is one of keypoints."""
_KNOWN = frozenset(name for names in LAYOUTS.values() for name in names) | {
    f"{joint}{JOINT}" for joint in JOINTS
}


def split_off_hands(points: Points3D) -> tuple[Points3D, Points3D | None]:
    """Split keypoints into the body's and 42 of the hands, which are None if there are none."""
    of_unity = any(re.search("thumb.*intermediate", name.lower()) for name in points.names)
    found = [_point_of_hand(name, of_unity=of_unity) for name in points.names]
    rows = {one: k for k, one in enumerate(found) if one is not None and one not in found[:k]}
    if len(rows) < _FEWEST:
        return points, None
    hands = np.full((len(points.positions), len(FINGER_POINTS), 3), np.nan)
    for name, k in rows.items():
        hands[:, FINGER_POINTS.index(name)] = points.positions[:, k]
    kept = [k for k, one in enumerate(found) if one is None]
    told = " ".join(rows)
    fingers = [f"{side}_{finger}" for side in SIDES if side in told for finger in FINGERS]
    lacking = ", ".join(one for one in fingers if one not in told)
    said = f"{len(rows)} points of hands, which fingers are fitted to"
    body = replace(
        points, names=tuple(points.names[k] for k in kept), positions=points.positions[:, kept],
        decisions=(*points.decisions, said + f"; none of {lacking}" * bool(lacking)),
    )  # fmt: skip
    return body, replace(points, names=FINGER_POINTS, positions=hands)


def _point_of_hand(label: str, *, of_unity: bool = False) -> str | None:
    """Return the name in `FINGER_POINTS` of a label such as LIndexPIP; None for another label.

    A label names a side, a finger and a place. Places are numbers from 1, the joint nearest to
    the wrist, to 4, the tip, or words; a number beside a word counts (OpenPose's LThumb2Knuckles).
    The proximal joint of a thumb is the second, after the metacarpal (OpenXR), but the first of
    Unity and VRM 0.x, whose thumbs have an intermediate one.
    """
    side, words = side_and_words_of(label)
    if side and words[-2:] in (["hand", "wrist"], ["hand", "root"]):
        return f"{side}_hand_wrist"
    at = next((k for k, word in enumerate(words) if word in FINGER_WORDS), -1)
    if not side or at < 0 or (at > 0 and words[at - 1] not in _BESIDE_FINGERS):
        return None
    finger = FINGER_WORDS[words[at]]
    rest = [word for word in words[at + 1 :] if word not in _BESIDE_FINGERS]
    numbers = [int(word) for word in rest if word.isdigit()]
    place = "".join(word for word in rest if not word.isdigit()).removesuffix("s")
    known = _PLACES_OF_THUMB if finger == "thumb" else _PLACES
    if place and place not in known:
        return None
    number = (numbers or [1 if of_unity and place == "proximal" else known.get(place, 0)])[0]
    names = {k: f"{side}_{finger}{k}" for k in (1, 2, 3)} | {4: f"{side}_{finger}_tip"}
    return names.get(number)


_FEWEST = 6
"""Points of hands, fewer of which are no fingers: some skeletons have the tips of thumbs."""
_BESIDE_FINGERS = ("hand", "finger", "phalanx", "joint", "f", "b")
"""Words beside a finger's name that say nothing, f of Rigify and b of Meta's headsets with them.
Other words before it mean no finger, as in left_foot_index."""
# Apple's joints are named by the bone that they begin or end, and the third joint of Goliath's
# points, counted from the tip, is the first
_OF_ALL = {"tip": 4, "distal": 3, "dp": 3, "knuckle": 1, "intermediatebase": 2,
           "intermediatetip": 3, "third": 1}  # fmt: skip
_PLACES = _OF_ALL | {"mcp": 1, "pip": 2, "dip": 3, "proximal": 1, "intermediate": 2, "pp": 1,
                     "mp": 2}  # fmt: skip
_PLACES_OF_THUMB = _OF_ALL | {"cmc": 1, "mcp": 2, "ip": 3, "metacarpal": 1, "mc": 1,
                              "proximal": 2, "intermediate": 2, "pp": 2}  # fmt: skip


def keypoints_of_labels(labels: Sequence[str]) -> list[str | None]:
    """Return recon's name of the keypoint that each label means; None for an unknown label.

    `head`, `neck`, `pelvis` and `foot` mean joints inside the body if other labels show that the
    points are a skeleton's joints, else a detector's keypoints. If no label means an ankle, `foot`
    means the ankle, as in Human3.6M. Names of bones mean the joints at which the bones begin.
    """
    if bones := limbs_of_bones(labels):
        trunk = [_TRUNK_BONES.get("".join(side_and_words_of(label)[1])) for label in labels]
        return [bones.get(k, one) for k, one in enumerate(trunk)]
    words = [_plain_spelling(label) for label in labels]
    joints = any(word in _JOINTS_ONLY for word in words)
    ankles = "left_ankle" in words
    found = [_keypoint_of_word(word, joints=joints, ankles=ankles) for word in words]
    if "spine_base" not in words:
        return found
    # the head joint of Kinect v2 is the middle of the head
    return ["head_centre" if one == f"head{JOINT}" else one for one in found]


def limbs_of_bones(labels: Sequence[str]) -> dict[int, str]:
    """Return the keypoint where each limb bone begins, by its label's index; {} if no bones.

    Bones are known by thighs, lower legs, upper arms and forearms (LeftUpLeg, shin.L, upperarm_r),
    which detectors do not name; the "shoulder" among them is the clavicle.
    """
    known = [
        (cut, meant.index(word), k, f"{side}_{joint}")
        for k, (side, words) in enumerate(map(side_and_words_of, labels))
        for cut in range(min(len(words), 4) if side else 0)
        for joint, meant in LIMBS.items()
        if (word := "".join(words[cut:])) in meant
    ]
    best = {joint: k for *_, k, joint in sorted(known, reverse=True)}
    for side, joint in product(SIDES, ("hip", "knee", "shoulder", "elbow")):
        place = best.get(f"{side}_{joint}")
        if place is None or joint in labels[place].lower():
            return {}
    # feet come first, so that ankles replace them: without toes, a bone called foot is the ankle
    joints = sorted(best, key=lambda one: not one.endswith("foot"))
    return {best[one]: f"{one}{JOINT}" if one.endswith("foot") else one for one in joints}


# bones of the trunk that begin at about the same place in all skeletons, unlike the spine
_TRUNK_BONES = {
    "hips": f"pelvis{JOINT}", "pelvis": f"pelvis{JOINT}", "neck": f"neck{JOINT}",
    "head": f"head{JOINT}",
}  # fmt: skip


def are_keypoints(labels: Sequence[str]) -> bool:
    """Whether most labels mean keypoints, with hips, knees and ankles among them.

    Markers that OpenCap's augmenter computed from keypoints and wrote beside them do not count,
    nor do points of hands.
    """
    others = (STUDY, *FINGER_POINTS)
    labels = [one for one in labels if not (_point_of_hand(one) or one).endswith(others)]
    found = keypoints_of_labels(labels)
    return set(_CORE) <= set(found) and sum(f is not None for f in found) > _MOST * len(labels)


def _plain_spelling(label: str) -> str:
    """Return a label in recon's spelling: LHip, HIP_LEFT and body_left_hip become left_hip."""
    label = re.sub(r"^K4ABT_JOINT_", "", label.strip().rsplit(":", 1)[-1], flags=re.IGNORECASE)
    lowered = re.sub(r"[^a-z0-9]+", "_", label.lower()).strip("_")
    if short := _ABBREVIATED.match(lowered):
        side = "left" if short[1] == "l" else "right"
        return _with_side(side, short[2].replace("_", ""))
    word = plain_part_name(_PREFIX.sub("", label if _PREFIX.match(lowered) is None else lowered))
    side, _, rest = word.partition("_")
    return _with_side(side, rest) if side in ("left", "right") and rest else word


def _with_side(side: str, name: str) -> str:
    return f"{side}_{_SAME_SIDED.get(name, name)}"


def _keypoint_of_word(word: str, *, joints: bool, ankles: bool) -> str | None:
    side, _, rest = word.partition("_")
    if joints:
        joint = word.replace("spine_1", "spine1").replace("spine_2", "spine2")
        joint = joint.replace("spine_3", "spine3")
        if joint in ("pelvis", "neck", "head", "spine1", "spine2", "spine3") or rest == "foot":
            return f"{joint}{JOINT}"
    if rest == "foot":
        return f"{word}{JOINT}" if ankles else f"{side}_ankle"
    name = _SAME.get(word, word)
    return name if name in _KNOWN else None
