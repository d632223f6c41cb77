"""Skeletons of common sources, told by the names of their joints, before anything else is read."""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import cast

from recon.core.errors import FormatError
from recon.formats.files.opening import decode, read_bytes

NEEDED = tuple(
    f"{side}_{name}"
    for side in ("left", "right")
    for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
)
"""Our joints without whose positions no full body can be fitted."""
SkeletonTable = Mapping[str, Mapping[str, str]]
"""Tables `joints`, `positions` and `orientations`: our joint, their joint."""


def plain(name: str) -> str:
    """A joint's name without namespace and case."""
    return name.split(":")[-1].lower()


@cache
def known_skeletons() -> Mapping[str, SkeletonTable]:
    """The tables of `assets/skeletons.toml` by their names."""
    text = files("recon").joinpath("assets", "skeletons.toml").read_text(encoding="utf-8")
    return cast("dict[str, SkeletonTable]", tomllib.loads(text))


def skeleton_among(names: Sequence[str], source: str) -> str:
    """The known skeleton of which most joints are there.

    Args:
        names: of the joints of a recording.
        source: what they were read from, for messages.

    Raises:
        ValueError: when there is none; says which mapping file to write.
    """
    theirs = {plain(name) for name in names}
    fitting = [
        (len(asked), name)
        for name, table in known_skeletons().items()
        if (asked := {plain(joint) for part in table.values() for joint in part.values()})
        <= theirs
    ]
    if fitting:
        return max(fitting)[1]
    joints = ", ".join(name for name in names if not name.endswith("_end"))
    raise FormatError(
        f"{source}: its skeleton is none of {', '.join(known_skeletons())}; its joints are "
        f"{joints}. Say which are ours in a TOML file, with lines like "
        f'left_knee = "LeftLeg" under [joints], for pelvis, {", ".join(NEEDED)} and whichever of '
        "left_foot, right_foot, neck, head, spine1, spine2 and spine3 there are, and give it with "
        "--mapping"
    )


def refuse_unknown_skeleton(path: Path) -> None:
    """Refuse a .bvh file whose skeleton nobody knows, by a look at the names of its joints.

    Files of other kinds, and files that are not there, pass.

    Raises:
        ValueError: as `skeleton_among` does.
    """
    if not path.name.lower().endswith((".bvh", ".bvh.xz")) or not path.is_file():
        return
    head, keyword, _ = decode(read_bytes(path)).partition("MOTION")
    words = head.split()
    starts = [k for k, word in enumerate(words[:-1]) if word.upper() in ("ROOT", "JOINT")]
    if keyword and starts:
        names = [words[k + 1] for k in starts]
        tips = [f"{name}_end" for name in names]  # those of last bones are joints too
        skeleton_among([*names, *tips], path.name)
