"""Reads motion-capture recordings of any known format, chosen by the file's suffix."""

import lzma
import tarfile
import tomllib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import cast

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import TEXT
from recon.core.units import Up
from recon.formats.opening import existing_file, limit_when_unpacked
from recon.formats.texts import decoded_text, read_bytes
from recon.mocap.asf_amc import read_amc
from recon.mocap.bvh import parse_bvh, parse_hierarchy, read_bvh
from recon.mocap.c3d import read_c3d
from recon.mocap.marker_tables import read_motive, read_qualisys, read_trc
from recon.mocap.mat import read_mat
from recon.mocap.recording import MarkerRecording, SkeletonRecording
from recon.mocap.trees import joints_by_tree

RECORDINGS = (
    ".bvh", ".bvh.xz", ".amc", ".amc.xz", ".c3d", ".trc", ".csv", ".tsv", ".mat", ".tar", ".tar.xz"
)  # fmt: skip
"""Suffixes that `read_recording` knows, among others of the same families."""
_READERS = {
    ".bvh": read_bvh, ".amc": read_amc, ".c3d": read_c3d, ".trc": read_trc, ".csv": read_motive,
    ".tsv": read_qualisys,
}  # fmt: skip
"""Readers of files that hold one recording."""


def read_recording(
    path: str | Path, unit: str | None = None, up: Up | None = None
) -> SkeletonRecording | MarkerRecording:
    """Read a recording of any known format, in metres and z up.

    Args:
        path: of the file; FILE::NAME is one recording of an archive or .mat file.
        unit: of the file (m, cm, mm, inch, ft, cmu); None finds it out.
        up: axis of the file that points up; None finds it out.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when the format is not known, the file is damaged, or unit or axis cannot be
            told; the message says what was expected.
    """
    location, _, inside = str(path).partition("::")
    file, name = Path(location), Path(location).name.lower()
    archived = name.endswith((".tar", ".tar.gz", ".tgz", ".tar.xz"))
    if inside and not (archived or name.endswith(".mat")):
        raise FormatError(f"{path}: only archives and .mat files hold several recordings (::)")
    if archived:
        return read_member(file, inside or None, unit=unit, up=up)
    if name.endswith(".mat"):
        return read_mat(file, inside or None, unit=unit, up=up)
    read = _READERS.get(Path(name.removesuffix(".xz")).suffix)
    if read is not None:
        return read(file, unit=unit, up=up)
    if name.endswith((".asf", ".asf.xz")):
        raise FormatError(f"{path}: this is a skeleton without motion; give one of its .amc files")
    if name.endswith((".npz", ".npz.xz")):
        raise FormatError(f"{path}: these are arrays, not a recording of motion capture")
    raise FormatError(
        f"{path}: not a known recording; expected one of {', '.join(RECORDINGS)}, or what "
        "`recon fit` reads (docs/files.md)"
    )


def bvh_texts_in_archive(path: Path) -> Iterator[tuple[str, str]]:
    """Yield name and text of every .bvh file in an archive, without unpacking it to disk.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged.
    """
    limit = limit_when_unpacked(existing_file(path), TEXT)
    try:
        with tarfile.open(path, "r|*") as archive:
            for member in archive:
                if not member.isfile() or not member.name.lower().endswith(".bvh"):
                    continue
                limit.check(member.size, f"{path}::{member.name}")
                file = archive.extractfile(member)
                assert file is not None  # None only for members that are no files
                yield member.name, decoded_text(file.read())
    except (tarfile.TarError, lzma.LZMAError, zlib.error, EOFError, OSError) as error:
        raise FormatError(f"{path}: expected a tar archive, but {error}") from error


def read_member(
    path: Path, member: str | None, *, unit: str | None = None, up: Up | None = None
) -> SkeletonRecording:
    """Read a recording of an archive, by name if the archive has several.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when there is no such recording, or it is damaged.
    """
    seen: list[str] = []
    chosen: list[tuple[str, str]] = []
    for name, text in bvh_texts_in_archive(path):
        if member in (None, name, Path(name).name, Path(name).stem):
            # texts of an archive may be larger than memory; whole names come before others
            chosen.append((name, text if not chosen or name == member else ""))
        seen.append(name)
    chosen = [one for one in chosen if one[0] == member] or chosen
    if len(chosen) == 1:
        return parse_bvh(chosen[0][1], chosen[0][0], unit=unit, up=up)
    held = [name for name, _ in chosen] or seen
    recordings = ", ".join([*held[:3], *["..."] * (len(held) > 3)] or ["none"])
    raise FormatError(
        f"{path}: expected BVH files, one chosen as {path.name}::NAME; it holds {recordings}"
    )


NEEDED = tuple(
    f"{side}_{name}"
    for side in ("left", "right")
    for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
)
"""Our joints without whose positions no full body can be fitted."""
SkeletonTable = Mapping[str, Mapping[str, str]]
"""Tables `joints`, `positions` and `orientations`: our joint, their joint."""


def plain_joint_name(name: str) -> str:
    """Return a joint's name in lower case, without its namespace."""
    return name.split(":")[-1].lower()


@cache
def known_skeletons() -> Mapping[str, SkeletonTable]:
    """The known skeletons of `assets/skeletons.toml`, keyed by name."""
    text = files("recon").joinpath("assets", "skeletons.toml").read_text(encoding="utf-8")
    return cast("dict[str, SkeletonTable]", tomllib.loads(text))


def skeleton_among(names: Sequence[str], source: str) -> str:
    """Return the name of the largest known skeleton of which a recording has all joints.

    Args:
        names: of the joints of a recording.
        source: what they were read from, for messages.

    Raises:
        ValueError: when no skeleton matches; says which mapping file to write.
    """
    theirs = {plain_joint_name(name) for name in names}
    fitting = [
        (len(asked), name)
        for name, table in known_skeletons().items()
        if (
            asked := {
                plain_joint_name(joint) for part in table.values() for joint in part.values()
            }
        )
        <= theirs
    ]
    if fitting:
        return max(fitting)[1]
    joints = ", ".join(name for name in names if not name.endswith("_end"))
    raise FormatError(
        f"{source}: its skeleton is none of {', '.join(known_skeletons())}; its joints are "
        f"{joints}. Name recon's joints among them in a TOML file, with lines like "
        f'left_knee = "LeftLeg" under [joints], for pelvis, {", ".join(NEEDED)} and whichever of '
        "left_foot, right_foot, neck, head, spine1, spine2 and spine3 there are, and give it with "
        "--mapping"
    )


def refuse_unknown_skeleton(path: Path) -> None:
    """Refuse a .bvh file with an unknown skeleton, judged by its joint names.

    Files of other kinds and missing files are not refused.

    Raises:
        ValueError: as `skeleton_among` does.
    """
    if not path.name.lower().endswith((".bvh", ".bvh.xz")) or not path.is_file():
        return
    head, keyword, _ = decoded_text(read_bytes(path)).partition("MOTION")
    if not keyword:
        return  # no BVH: reading the file will raise the error
    joints = parse_hierarchy(head, path.name)
    names, parents = [one.name for one in joints], [one.parent for one in joints]
    if joints_by_tree(names, parents, np.array([one.offset for one in joints])) is None:
        skeleton_among(names, path.name)
