"""Names that other programs give to the joints: the table `assets/bone_names.txt`."""

import re
from functools import cache
from importlib.resources import files
from typing import Literal

from recon.core.errors import ReconError

BoneNames = Literal["smpl", "mixamo", "unreal", "vrm", "rigify", "xsens"]
"""Whose names bones get: ours (SMPL's), Mixamo's, those of Unreal's UE5 mannequin, of VRM 1.0 and
Unity's humanoids, of Rigify's human metarig, or of the segments of Xsens' MVNX files."""

LIMBS = {
    "shoulder": ("upperarm", "uparm", "arm", "armupper", "humerus", "shldr",
                 "shldrbend", "shoulder"),
    "elbow": ("forearm", "lowerarm", "lowarm", "loarm", "armlower", "elbow", "forearmbend"),
    "wrist": ("hand", "wrist"),
    "hip": ("upleg", "thigh", "upperleg", "uperleg", "legupper", "thighbend", "femur", "hip"),
    "knee": ("shin", "calf", "lowerleg", "lowleg", "leglower", "knee", "tibia", "leg"),
    "ankle": ("ankle", "foot"),
    "foot": ("toebase", "toes", "toe", "ball", "foot"),
}  # fmt: skip
"""Words for the bone of each limb joint, without side and separators, the surest first."""
FINGER_WORDS = {
    "thumb": "thumb", "index": "index", "middle": "middle", "mid": "middle", "ring": "ring",
    "pinky": "pinky", "little": "pinky", "pinkie": "pinky", "small": "pinky",
    "forefinger": "index",
    "first": "thumb", "second": "index", "third": "middle", "fourth": "ring", "fifth": "pinky",
}  # fmt: skip
"""Words for fingers in names of bones and points, keyed to the names in `FINGERS`."""
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")


@cache
def names_of_joints() -> dict[str, dict[str, str]]:
    """Names of body and finger joints in other programs: {program: {our name: its name}}."""
    text = files("recon").joinpath("assets", "bone_names.txt").read_text(encoding="utf-8")
    (_, *programs), *rows = (line.split() for line in text.splitlines())
    return {
        program: {joint: theirs[k] for joint, *theirs in rows}
        for k, program in enumerate(programs)
    }


def joint_names_in(joints: tuple[str, ...], program: str) -> tuple[str, ...]:
    """Translate names of joints, and of tips called `<joint>_end`, to those of a program.

    Raises:
        ReconError: when no such program is known; the message lists those that are.
    """
    if program == "smpl":
        return joints
    if program not in (known := names_of_joints()):
        raise ReconError(f"names: expected one of smpl, {', '.join(known)}, got {program!r:.60}")
    theirs = known[program]
    return tuple(
        theirs[joint.removesuffix("_end")] + "_end" * joint.endswith("_end") for joint in joints
    )


def side_and_words_of(name: str) -> tuple[str, list[str]]:
    """Split a bone's name into a side ("left", "right" or "") and words in lower case."""
    plain = re.split(r"[:|]", name)[-1][-80:]
    words, side = [], ""
    for word in (one.lower() for one in _WORDS.findall(plain)):
        if word in ("left", "l", "right", "r") and not side:
            side = "left" if word[0] == "l" else "right"
        else:
            words.append(word)
    return side, words
