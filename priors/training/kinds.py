"""The kind of motion that a recording shows, by the words of its description."""

import json
from collections.abc import Mapping
from pathlib import Path

KINDS: Mapping[str, tuple[str, ...]] = {
    "uneven ground": ("uneven", "playground", "stairs"),
    "run": ("run", "jog"),
    "walk": ("walk",),
    "jump": ("jump",),
    "dance": ("danc",),
    "fight": ("martial", "punch", "sword"),
    "ball": ("soccer", "basketball"),
}
"""Words of a recording's description that tell the kind of motion; the first kind counts."""
OTHER = "other"


def kind_of(description: str) -> str:
    """The kind of motion that a description of a recording tells."""
    text = description.lower()
    for kind, words in KINDS.items():
        if any(word in text for word in words):
            return kind
    return OTHER


def described(motion: Path) -> str:
    """The action that the notes beside a converted motion name; its file name without notes."""
    beside = motion.with_suffix(".json")
    if not beside.is_file():
        return motion.stem
    return str(json.loads(beside.read_text(encoding="utf-8")).get("action", motion.stem))
