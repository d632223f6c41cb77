"""Named points on the bundled body's surface, and the marker labels that mean them.

A landmark is a vertex of the bundled mesh (`assets/landmarks.json`, found geometrically by
`scripts/build_landmarks.py`). Marker labels of the common protocols map to landmarks through
`assets/markers.toml`; a marker's own distance from the skin is not part of it. Bodies with another
mesh have other vertices: these numbers do not hold for SMPL files.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import cast

from recon.core.errors import ReconError

_SIDED = (
    "acromion", "elbow_lateral", "elbow_medial", "wrist_radial", "wrist_ulnar", "hand",
    "thigh_lateral", "knee_lateral", "knee_medial", "ankle_lateral", "ankle_medial", "heel",
    "big_toe",
)  # fmt: skip
KEYPOINTS_43: tuple[str, ...] = (
    "nose", "head_top", "back_head", "left_ear", "right_ear",
    "c7", "t10", "sternal_notch", "xiphoid", "navel", "sacrum",
    "left_chest", "right_chest", "left_asis", "right_asis", "left_psis", "right_psis",
    *(f"left_{name}" for name in _SIDED),
    *(f"right_{name}" for name in _SIDED),
)  # fmt: skip
"""43 landmarks spread over the body, like the virtual markers of HuMoR's experiments (section 5).

Five on the head, twelve on the trunk, six per arm and seven per leg; left and right mirror
each other.
"""

LANDMARKS_16: tuple[str, ...] = (
    "left_front_head", "sternal_notch",
    *(
        f"{side}_{name}"
        for side in ("left", "right")
        for name in (
            "acromion", "elbow_lateral", "wrist_radial", "asis", "knee_lateral", "ankle_lateral",
            "toe2_base",
        )
    ),
)  # fmt: skip
"""16 landmarks as sparse as a marker recording gets, one for every segment that moves by itself.

Nearly all marker protocols put a marker on each; of heads, those that mark them at all mark the
temples' front.
"""

_SIDES = {"left": ("l", "left"), "right": ("r", "right")}
_IGNORED = re.compile(r"[\s._\-]+")


@cache
def landmarks() -> Mapping[str, int]:
    """Vertex number on the bundled body of every landmark, by name."""
    text = files("recon").joinpath("assets", "landmarks.json").read_text(encoding="utf-8")
    return MappingProxyType(cast("dict[str, int]", json.loads(text)))


def landmark(name: str) -> int:
    """Vertex number of a landmark on the bundled body."""
    try:
        return landmarks()[name]
    except KeyError:
        raise ReconError(
            f"no landmark {name!r}; there are: {', '.join(sorted(landmarks()))}"
        ) from None


def normalised(label: str) -> str:
    """A marker label without subject prefix, case, spaces, dots, underscores and hyphens."""
    return _IGNORED.sub("", label.rsplit(":", 1)[-1]).lower()


def match_markers(labels: Iterable[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Landmark of every known label, and the labels nobody knows, in their order.

    Labels keep the spelling they came with. Two labels may share a landmark. A recording that
    uses one label for several markers must be told apart before: equal labels are one entry.
    """
    table = _synonyms()
    matched: dict[str, str] = {}
    unknown: list[str] = []
    for label in labels:
        point = table.get(normalised(label))
        if point is None:
            unknown.append(label)
        else:
            matched[label] = point
    return matched, tuple(unknown)


def load_marker_map(path: str | Path) -> dict[str, int]:
    """A user's own mapping, marker label -> vertex number on the bundled body.

    The TOML file holds one line per marker: `"Subject:LASI" = "left_asis"` (a landmark's name) or
    `"C7" = 1234` (a vertex number).
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no marker map at {path}; expected a TOML file, label = landmark")
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ReconError(
            f'{path} is not TOML ({error}); write one line per marker, like "LASI" = "left_asis"'
        ) from error
    return {label: _vertex(path, label, point) for label, point in entries.items()}


def _vertex(path: Path, label: str, point: object) -> int:
    if isinstance(point, str):
        try:
            return landmark(point)
        except ValueError as error:
            raise ReconError(f"{path}, marker {label!r}: {error}") from None
    if isinstance(point, int) and not isinstance(point, bool) and point >= 0:
        return point
    if isinstance(point, dict):
        raise ReconError(
            f"{path}: {label!r} became a table; labels with dots need quotes, "
            f'like "{label}.ASIS" = "left_asis"'
        )
    raise ReconError(
        f"{path}, marker {label!r}: expected a landmark's name or a vertex number, got {point!r}"
    )


@cache
def _synonyms() -> Mapping[str, str]:
    """Normalised label -> landmark, from `assets/markers.toml`."""
    text = files("recon").joinpath("assets", "markers.toml").read_text(encoding="utf-8")
    sections = cast("dict[str, dict[str, list[str]]]", tomllib.loads(text))
    table: dict[str, str] = {}

    def add(label: str, point: str) -> None:
        known = table.setdefault(normalised(label), point)
        if known != point or point not in landmarks():
            raise ReconError(f"markers.toml: label {label!r} -> {point!r}, but also {known!r}")

    for section in ("middle", "single"):
        for point, labels in sections[section].items():
            for label in labels:
                add(label, point)
    for point, patterns in sections["pairs"].items():
        for side, spellings in _SIDES.items():
            for pattern in patterns:
                for spelling in spellings:
                    add(pattern.replace("*", spelling), f"{side}_{point}")
    return MappingProxyType(table)
