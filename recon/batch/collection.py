"""Lists the recordings of a folder, with unique names and notes from manifests."""

import csv
import hashlib
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from recon.formats.replacing import file_checksum, value_checksum
from recon.mocap.asf_amc import find_skeleton
from recon.mocap.bvh import parse_bvh
from recon.mocap.reader import bvh_texts_in_archive, read_recording
from recon.mocap.recording import SkeletonRecording, drop_lead_in

_SUFFIXES = (".bvh.xz", ".amc.xz", ".bvh", ".amc")
_LEFT_OUT = {
    (".c3d", ".trc", ".mat"): "no .bvh or .amc; convert it by `recon convert FILE`, or fit "
    "many by `recon batch`",
    (".tar", ".tar.gz", ".tgz"): "archives are read where a manifest.csv names their clips",
    (".bvh", ".amc"): "no row of a manifest.csv names it",
}
"""Why recordings with these suffixes, also with .xz, are not among the clips of a folder."""
_UNEVEN = ("playground", "uneven")


@dataclass(frozen=True)
class SourceClip:
    """The path, name and manifest notes of one recording in a collection, not yet read."""

    collection: str
    """Folder below the root, used for its output too."""
    name: str
    """Name of the output: its path in the collection without the suffix, or what the manifest
    says."""
    path: Path
    """Path of the file or of the archive that holds it."""
    member: str | None = None
    notes: dict[str, str] = field(default_factory=dict)
    """Its row of the manifest."""

    @property
    def id(self) -> str:
        """The clip's name, unique among all collections."""
        return f"{self.collection}/{self.name}"

    @property
    def source(self) -> str:
        """Path of the recording's file, with its name in the archive if any; for messages."""
        return str(self.path) if self.member is None else f"{self.path}::{self.member}"

    @property
    def subject(self) -> str:
        """Name of the recorded person in the manifest; empty if it has none."""
        return self.notes.get("subject") or self.notes.get("actor") or ""

    @property
    def action(self) -> str:
        """Action and style in the manifest, such as "walk, slow"; empty if it has none."""
        parts = (self.notes.get("action", ""), self.notes.get("style", ""))
        return ", ".join(part for part in parts if part)

    @property
    def on_flat_ground(self) -> bool:
        """Whether the ground is one plane, unlike playgrounds or uneven terrain."""
        return not any(word in self.action.lower() for word in _UNEVEN)

    @property
    def reliable_contacts(self) -> bool:
        """Whether foot contacts are reliable, which they are not on a skeleton that all share.

        They are not where motions were copied to another skeleton.
        """
        return "one common skeleton" not in self.notes.get("skeleton", "")


def clips_by_collection(root: Path) -> list[list[SourceClip]]:
    """List the clips below a folder by collection: each subfolder with a manifest, else itself.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when nothing in it is a recording of a skeleton, a manifest is damaged, or two
            recordings would have one output; both are named.
    """
    if not root.is_dir():
        raise FileNotFoundError(f"{root}: no such folder")
    beside = (root / "manifest.csv", *sorted(root.glob("*/manifest.csv")))
    folders = [m.parent for m in beside if m.is_file()] or [root]
    found = [list(_clips_of_collection(folder, root)) for folder in folders]
    found = [clips for clips in found if clips]
    if not found:
        raise ValueError(
            f"{root}: expected BVH or AMC files or archives of them, found none; files of markers "
            "are converted one by one (`recon convert FILE`), or fitted by `recon batch`"
        )
    _check_names([clip for clips in found for clip in clips])
    return found


def recordings_left_out(
    root: Path, found: Sequence[Sequence[SourceClip]]
) -> list[tuple[SourceClip, str]]:
    """List the other recordings below a folder, with the reasons why they are not converted.

    Tables (.csv, .tsv) are not listed: few of them are recordings.
    """
    known = {clip.path.resolve() for clips in found for clip in clips}
    names = {path: path.name.lower().removesuffix(".xz") for path in sorted(root.rglob("*"))}
    title = root.name or root.resolve().name
    return [
        (SourceClip(title, path.relative_to(root).as_posix(), path), reason)
        for path, name in names.items()
        for suffixes, reason in _LEFT_OUT.items()
        if name.endswith(suffixes) and path.resolve() not in known
    ]


def _clips_of_collection(folder: Path, root: Path) -> Iterator[SourceClip]:
    manifest = folder / "manifest.csv"
    title = str(folder.relative_to(root)) if folder != root else (root.name or root.resolve().name)
    if not manifest.is_file():
        for path in sorted(folder.rglob("*")):
            if path.name.lower().endswith(_SUFFIXES):
                yield SourceClip(title, _without_suffix(path.relative_to(folder).as_posix()), path)
        return
    for number, row in _manifest_rows(manifest):
        where = f"{manifest}, line {number}"
        if row.get("archive"):
            if not row.get("clip"):
                raise ValueError(
                    f"{where}: expected the name of a clip of {row['archive']} in the column "
                    "clip, got none"
                )
            clip = SourceClip(title, row["clip"], folder / row["archive"], row["clip"], row)
        elif row.get("path", "").lower().endswith(_SUFFIXES):
            clip = SourceClip(title, _clip_name(row), folder / row["path"], None, row)
        elif row.get("path"):
            continue
        else:
            raise ValueError(
                f"{where}: expected a path, or an archive and a clip in it, got neither"
            )
        parts = clip.name.split("/")
        if any(part in ("", ".", "..") for part in parts) or "\0" in clip.name:
            raise ValueError(
                f"{where}: expected a name of the clip that can be a path below OUT, got "
                f"{clip.name!r}; give another one in the column clip"
            )
        yield clip


def _manifest_rows(manifest: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Line numbers and rows of a manifest; missing cells are empty."""
    try:
        with manifest.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, restkey="")
            for row in reader:
                yield reader.line_num, {k: v or "" for k, v in row.items() if k}
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{manifest}: expected a table in CSV and UTF-8, but {error}") from error


def _clip_name(row: dict[str, str]) -> str:
    """The manifest's name of a clip: column `clip`, else the path without suffix."""
    path = _without_suffix(Path(row["path"]).as_posix())
    return row["clip"] or Path(path).name if "clip" in row else path


def _without_suffix(name: str) -> str:
    """A file name without the suffix of its format; other dots are part of the name."""
    ending = next((end for end in _SUFFIXES if name.lower().endswith(end)), "")
    return name[: len(name) - len(ending)]


def _check_names(clips: Sequence[SourceClip]) -> None:
    """Refuse recordings whose outputs would be the same file on some file system."""
    taken: dict[str, SourceClip] = {}
    for clip in clips:
        same = unicodedata.normalize("NFC", clip.id).casefold()
        if same in taken:
            raise ValueError(
                f"{taken[same].source} and {clip.source} would both be written as {clip.id}.npz; "
                "rename one of them (or its clip in the manifest)"
            )
        taken[same] = clip


@dataclass(frozen=True)
class ClipContent:
    """A clip with its content: a file, a text from an archive, or the reason it is missing."""

    clip: SourceClip
    text: str | None = None
    inside: str = ""
    """Name of the text in the archive."""
    missing: str = ""

    def checksum(self) -> str:
        """Return the SHA-256 of the clip's files or of its text in the archive.

        Raises:
            OSError, ValueError: when something cannot be read.
        """
        if self.text is not None:
            return hashlib.sha256(self.text.encode("utf-8", "surrogatepass")).hexdigest()
        files = [self.clip.path]
        if ".amc" in self.clip.path.name.lower():
            files.append(find_skeleton(self.clip.path))
        return value_checksum([file_checksum(file) for file in files])

    def read(self) -> SkeletonRecording:
        """Read the recording, without a T-pose at its start.

        Raises:
            ValueError: when there is none, with the reason.
        """
        if self.missing:
            raise ValueError(self.missing)
        try:
            if self.text is not None:
                return drop_lead_in(parse_bvh(self.text, self.inside))
            recording = read_recording(self.clip.path)
        except (FileNotFoundError, ValueError) as error:
            raise ValueError(str(error)) from error
        if not isinstance(recording, SkeletonRecording):
            raise ValueError(f"{self.clip.path}: expected a skeleton, got markers")
        return drop_lead_in(recording)


def contents_of_clips(clips: Sequence[SourceClip]) -> Iterator[ClipContent]:
    """Yield the content of every clip; each archive is read only once.

    A second entry of one name in an archive is yielded, too, as a clip that cannot be read.
    """
    packed: dict[Path, dict[str, SourceClip]] = {}
    for clip in clips:
        if clip.member is None:
            yield ClipContent(clip)
        else:
            packed.setdefault(clip.path, {})[clip.member] = clip
    for archive, members in packed.items():
        missing, found = f"not in {archive.name}", dict[str, SourceClip]()
        try:
            for inside, text in bvh_texts_in_archive(archive):
                names = (inside, _without_suffix(inside), Path(inside).stem)
                if (member := next((name for name in names if name in members), None)) is not None:
                    found[member] = members.pop(member)
                    yield ClipContent(found[member], text, inside)
                elif (member := next((name for name in names if name in found), None)) is not None:
                    several = f"{archive.name} has several recordings {member!r}, one of them "
                    several += f"{inside}; name it in the manifest by its path in the archive"
                    yield ClipContent(found[member], missing=several)
        except (FileNotFoundError, ValueError) as error:
            missing = str(error)
        for clip in members.values():
            yield ClipContent(clip, missing=missing)


def skeleton_key(recording: SkeletonRecording) -> str:
    """Return a key of joint names and bone lengths, equal for recordings of one skeleton."""
    lengths = np.linalg.norm(recording.rest_offsets[recording.body_root + 1 :], axis=-1)
    return ",".join(recording.joint_names) + str((1000 * lengths).round().astype(int).tolist())
