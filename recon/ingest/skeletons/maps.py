"""Correspondences of the joints of recorded skeletons to ours: known ones, or from a file."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from recon.core.errors import ReconError
from recon.core.skeleton import FEET, JOINTS, joint_index
from recon.formats.mocap.recording import SkeletonRecording
from recon.formats.mocap.skeletons import (
    NEEDED,
    SkeletonTable,
    known_skeletons,
    plain,
    skeleton_among,
)


@dataclass(frozen=True)
class SkeletonMap:
    """Our joints in a recorded skeleton; feet come last, so that they are one run of rows."""

    name: str
    positions: tuple[tuple[int, str], ...]
    """(our joint, their joint whose position it has)."""
    orientations: tuple[tuple[int, str], ...]
    """(our joint, their joint that turns with its bone)."""

    @property
    def joints(self) -> tuple[int, ...]:
        """Our joints whose positions are known."""
        return tuple(joint for joint, _ in self.positions)

    @property
    def bones(self) -> tuple[int, ...]:
        """Our joints whose bones' orientations are known."""
        return tuple(joint for joint, _ in self.orientations)

    @property
    def feet(self) -> tuple[int, int]:
        """First and last + 1 of the rows of `positions` that are ankles and toes."""
        return sum(joint not in FEET for joint in self.joints), len(self.joints)


def recognise(recording: SkeletonRecording, mapping: str | Path | None = None) -> SkeletonMap:
    """The joints of a recording that are ours.

    Args:
        recording: of any skeleton.
        mapping: TOML file with tables [joints], [positions], [orientations] as in
            `assets/skeletons.toml`; None tries the skeletons known there.

    Raises:
        FileNotFoundError: when there is no such mapping file.
        ValueError: when the skeleton is not known, or the file names joints that do not exist.
    """
    theirs = {plain(name): name for name in recording.joint_names}
    if mapping is not None:
        return _user_map(Path(mapping), theirs, recording)
    name = skeleton_among(recording.joint_names, recording.name)
    return _build(name, known_skeletons()[name], theirs)


def _user_map(path: Path, theirs: Mapping[str, str], recording: SkeletonRecording) -> SkeletonMap:
    if not path.is_file():
        raise FileNotFoundError(f"no skeleton mapping at {path}; expected a TOML file")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ReconError(f"{path}: not TOML ({error})") from error
    parts = {"joints", "positions", "orientations"}
    if not table or set(table) - parts or not all(isinstance(p, dict) for p in table.values()):
        raise ReconError(
            f"{path}: expected the tables {', '.join(sorted(parts))}, got {', '.join(table)}"
        )
    for part in table.values():
        for ours, joint in part.items():
            joint_index(ours)
            if not isinstance(joint, str) or plain(joint) not in theirs:
                raise ReconError(
                    f"{path}: {ours} = {joint!r}, but {recording.name} has "
                    f"{', '.join(recording.joint_names)}"
                )
    found = _build(path.stem, cast(SkeletonTable, table), theirs)
    if missing := [n for n in NEEDED if joint_index(n) not in found.joints]:
        raise ReconError(f"{path}: positions of {', '.join(missing)} are needed for a full body")
    return found


def _build(name: str, table: SkeletonTable, theirs: Mapping[str, str]) -> SkeletonMap:
    both = dict(table.get("joints", {}))
    positions = both | dict(table.get("positions", {}))
    orientations = both | dict(table.get("orientations", {}))

    def ordered(part: Mapping[str, str]) -> tuple[tuple[int, str], ...]:
        numbers = sorted(map(joint_index, part), key=lambda j: (j in FEET, j))
        return tuple((j, theirs[plain(part[JOINTS[j]])]) for j in numbers)

    return SkeletonMap(name, ordered(positions), ordered(orientations))
