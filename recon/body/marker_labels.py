"""Finds the landmark of each marker label, by common marker protocols or a user's mapping.

Labels map to landmarks through `assets/markers.toml`; a marker's own distance from the skin is not
part of it.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from itertools import takewhile
from pathlib import Path
from types import MappingProxyType
from typing import cast

from recon.body.landmarks import landmark, landmarks
from recon.core.errors import ReconError
from recon.formats.json_files import read_json
from recon.formats.texts import read_toml

FEWEST_MARKERS = 10
"""Markers of known places without which no recording is put on a body."""
_SIDES = {"left": ("l", "left"), "right": ("r", "right")}
_IGNORED = re.compile(r"[\s._\-]+")
_NAMELESS = re.compile(
    r"\*?\d*|[uc]_\d+|(un(label+ed|named|known|identified)|new|trajectory|marker|point|track)\W*\d*",
    re.IGNORECASE,
)


def normalised_label(label: str) -> str:
    """A marker label without subject prefix, case, spaces, dots, underscores and hyphens."""
    return _IGNORED.sub("", label.rsplit(":", 1)[-1]).lower()


def match_markers(labels: Iterable[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the landmark of every known marker label, and a tuple of the unknown labels.

    Labels keep the spelling they came with. Two labels may share a landmark. A recording that
    uses one label for several markers must be told apart before: equal labels are one entry. A
    beginning that all labels share (Walk01_LASI, Walk01_RASI) is ignored where more are known
    without it.
    """
    labels = tuple(labels)
    plain = {label: normalised_label(label) for label in labels}
    table = _landmark_of_label()
    if (shorter := _without_common_prefix(labels)) is not None and (
        sum(word in table for word in shorter.values())
        > sum(word in table for word in plain.values())
    ):
        plain |= shorter
    words = set(plain.values())
    matched: dict[str, str] = {}
    unknown: list[str] = []
    for label, word in plain.items():
        point = None if _marker_of_joint_centre().get(word) in words else table.get(word)
        if point is None:
            unknown.append(label)
        else:
            matched[label] = point
    return matched, tuple(unknown)


def is_nameless(label: str) -> bool:
    """Whether a marker label is no name: *12, U_1, unlabeled-12, Trajectory 3, or empty."""
    return _NAMELESS.fullmatch(label.rsplit(":", 1)[-1].strip()) is not None


def are_nameless(labels: Sequence[str]) -> bool:
    """Whether most labels of a recording are no names, and few are known marker names."""
    bare = sum(is_nameless(label) for label in labels)
    return 2 * bare > len(labels) and len(match_markers(labels)[0]) < FEWEST_MARKERS


def _without_common_prefix(labels: Sequence[str]) -> dict[str, str] | None:
    """Strip the common prefix (up to a separator) of marker labels; None if there is none.

    Returns the normalised rest of every label; labels that are no names are ignored.
    """
    named = [label for label in labels if not is_nameless(label)]
    same = takewhile(lambda column: len(set(column)) == 1, zip(*named, strict=False))
    beginning = "".join(column[0] for column in same)
    cut = max((beginning.rfind(mark) for mark in "_.-: "), default=-1) + 1
    if len(named) < 2 or cut == 0:
        return None
    return {label: normalised_label(label[cut:]) for label in named}


@cache
def marker_sets() -> Mapping[str, Mapping[str, str]]:
    """Load `assets/marker_sets.toml`: {marker set: {label: landmark or keypoint}}."""
    text = files("recon").joinpath("assets", "marker_sets.toml").read_text(encoding="utf-8")
    return cast("dict[str, dict[str, str]]", tomllib.loads(text))


def load_marker_map(path: str | Path) -> dict[str, int | None]:
    """Read a user's mapping from marker labels to vertex numbers of the bundled body.

    The file is JSON or TOML with one entry per marker: `"Subject:LASI": "left_asis"` (a landmark's
    name) or `"C7": 1234` (a vertex number); an empty text leaves a marker out and gives None.

    Raises:
        FileNotFoundError: when there is no such file.
        ReconError: when it is damaged, or names no landmark; says what to write.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"no marker map at {path}; expected a JSON or TOML file, label = landmark"
        )
    try:
        entries = read_json(path) if path.suffix.lower() == ".json" else read_toml(path)
    except ValueError as error:
        raise ReconError(
            f"{path} is not TOML or JSON ({error}); write one line per marker, like "
            '"LASI" = "left_asis" (TOML) or {"LASI": "left_asis"} (JSON)'
        ) from error
    if not isinstance(entries, dict):
        raise ReconError(f'{path}: expected an object like {{"LASI": "left_asis"}}')
    return {label: _vertex_number(path, label, point) for label, point in entries.items()}


def advice_on_mapping(labels: Sequence[str]) -> str:
    """Return advice for error messages: how to write a mapping file for these labels."""
    shown = ", ".join(f'"{label}": "LANDMARK"' for label in labels[:3])
    more = ", ..." if len(labels) > 3 else ""
    return (
        f"write a file names.json that says where markers sit, {{{shown}{more}}}, and give the "
        "file with --mapping; landmarks are left_asis, sacrum, right_knee_lateral, ... "
        "(docs/start/points.md)"
    )


def _vertex_number(path: Path, label: str, point: object) -> int | None:
    if point in ("", None):
        return None
    if isinstance(point, str):
        try:
            return landmark(point)
        except ValueError as error:
            raise ReconError(f"{path}, marker {label!r}: {error}") from None
    if isinstance(point, int) and not isinstance(point, bool) and point >= 0:
        return point
    if isinstance(point, dict):
        raise ReconError(
            f"{path}: expected a landmark for {label!r}, got a table; put labels with dots in "
            f'quotes, like "{label}.ASIS" = "left_asis"'
        )
    raise ReconError(
        f"{path}, marker {label!r}: expected a landmark's name or a vertex number, got {point!r}"
    )


@cache
def _landmark_of_label() -> Mapping[str, str]:
    """Load the table {normalised marker label: landmark} from `assets/markers.toml`."""
    sections = _label_sections()
    table: dict[str, str] = {}

    def add(label: str, point: str) -> None:
        known = table.setdefault(normalised_label(label), point)
        if known != point or point not in landmarks():
            raise ReconError(
                f"markers.toml: {label!r} is both {point!r} and {known!r}; expected one landmark"
            )

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


@cache
def _marker_of_joint_centre() -> Mapping[str, str]:
    """Map each computed joint centre's label to the marker label at that joint, normalised."""
    pairs = cast("dict[str, str]", _label_sections()["centres"])
    return MappingProxyType(
        {
            normalised_label(label.replace("*", spelling)): normalised_label(
                other.replace("*", spelling)
            )
            for label, other in pairs.items()
            for spellings in _SIDES.values()
            for spelling in spellings
        }
    )


@cache
def _label_sections() -> Mapping[str, dict[str, list[str]]]:
    text = files("recon").joinpath("assets", "markers.toml").read_text(encoding="utf-8")
    return cast("dict[str, dict[str, list[str]]]", tomllib.loads(text))
