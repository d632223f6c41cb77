"""What a folder of recordings holds: clips by skeleton, with the notes of its manifests."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from recon.formats import read_recording
from recon.formats.archives import iterate_texts
from recon.formats.bvh import parse_bvh
from recon.recording import SkeletonRecording, drop_lead_in

_SUFFIXES = (".bvh", ".bvh.xz", ".amc", ".amc.xz")
_ARCHIVES = (".tar", ".tar.gz", ".tgz", ".tar.xz")
_UNEVEN = ("playground", "uneven")


@dataclass(frozen=True)
class Clip:
    """One recording of a collection, not yet read."""

    collection: str
    """Folder below the root, used for its output too."""
    name: str
    path: Path
    """Of the file or of the archive that holds it."""
    member: str | None = None
    notes: dict[str, str] = field(default_factory=dict)
    """Its row of the manifest."""

    @property
    def subject(self) -> str:
        """Who moves, as the manifest says."""
        return self.notes.get("subject") or self.notes.get("actor") or ""

    @property
    def action(self) -> str:
        """What is done."""
        parts = (self.notes.get("action", ""), self.notes.get("style", ""))
        return ", ".join(part for part in parts if part)

    @property
    def flat(self) -> bool:
        """The ground is one plane: no playground, no uneven terrain."""
        return not any(word in self.action.lower() for word in _UNEVEN)

    @property
    def contacts(self) -> bool:
        """Feet stand where they should: not so where one skeleton took over others' paths."""
        return "one common skeleton" not in self.notes.get("skeleton", "")


def collections(root: Path) -> list[list[Clip]]:
    """The clips below a folder, by collection: the folders that hold a manifest, or the folder.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when nothing in it is a recording of a skeleton.
    """
    if not root.is_dir():
        raise FileNotFoundError(f"{root}: no such folder")
    beside = (root / "manifest.csv", *sorted(root.glob("*/manifest.csv")))
    folders = [m.parent for m in beside if m.is_file()] or [root]
    found = [list(_clips(folder, root)) for folder in folders]
    found = [clips for clips in found if clips]
    if not found:
        raise ValueError(f"{root}: expected BVH or AMC files or archives of them, found none")
    return found


def _clips(folder: Path, root: Path) -> Iterator[Clip]:
    manifest = folder / "manifest.csv"
    title = str(folder.relative_to(root)) if folder != root else folder.name
    if not manifest.is_file():
        for path in sorted(folder.rglob("*")):
            if path.name.lower().endswith(_SUFFIXES):
                name = "_".join(path.relative_to(folder).parts).split(".")[0]
                yield Clip(title, name, path)
        return
    with manifest.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if "archive" in row:
                yield Clip(title, row["clip"], folder / row["archive"], row["clip"], row)
            elif row["path"].lower().endswith(_SUFFIXES):
                name = Path(row["path"]).name.split(".")[0]
                yield Clip(title, name, folder / row["path"], None, row)


def read_clips(clips: list[Clip]) -> Iterator[tuple[Clip, SkeletonRecording | str]]:
    """Clips with their recordings, T-pose cut, or with why there is none; archives once each."""
    packed: dict[Path, dict[str, Clip]] = {}
    for clip in clips:
        if clip.member is None:
            yield clip, _read_file(clip.path)
        else:
            packed.setdefault(clip.path, {})[clip.member] = clip
    for archive, members in packed.items():
        missing = f"not in {archive.name}"
        try:
            for inside, text in iterate_texts(archive):
                if clip := members.pop(Path(inside).stem, None):
                    yield clip, _parse(text, inside)
        except (FileNotFoundError, ValueError) as error:
            missing = str(error)
        for clip in members.values():
            yield clip, missing


def _read_file(path: Path) -> SkeletonRecording | str:
    try:
        recording = read_recording(path)
    except (FileNotFoundError, ValueError) as error:
        return str(error)
    if not isinstance(recording, SkeletonRecording):
        return f"{path}: expected a skeleton, got markers"
    return drop_lead_in(recording)


def _parse(text: str, name: str) -> SkeletonRecording | str:
    try:
        return drop_lead_in(parse_bvh(text, name))
    except ValueError as error:
        return str(error)


def skeleton_key(recording: SkeletonRecording) -> str:
    """Equal for recordings of one skeleton: names and bone lengths to the millimetre."""
    lengths = np.linalg.norm(recording.rest_offsets[recording.body_root + 1 :], axis=-1)
    return ",".join(recording.joint_names) + str((1000 * lengths).round().astype(int).tolist())
