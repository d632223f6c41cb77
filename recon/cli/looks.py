"""Refuses unsuitable files and unknown priors quickly, before torch is loaded."""

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

from recon.core.plugins import PRIORS, registered_places

_ENDINGS = (".c3d", ".trc")
EXPECTED = (
    "a film (.mp4, .mov, ...), an observation (.npz), 3D keypoints (.npy, .npz, .csv, .json, "
    ".trc, .c3d or a session folder), markers (.c3d, .trc), 2D keypoints (.json, .csv or folders "
    "of them, with --camera), a folder of scans (.ply, .pcd, .obj, .xyz) or depth images (.png)"
)
_HEAD = 1 << 16
"""Bytes at the start of a file that are looked at."""


def refuse_unsuitable(given: Mapping[str, Any]) -> None:
    """Refuse arguments that cannot work: unknown priors, markers, and unsuitable files.

    Args:
        given: a verb's arguments by name.

    Raises:
        ValueError: says what was seen and what would fit.
    """
    if (settings := given.get("settings")) is not None:
        check_plugins(settings.prior, settings.reader)
        from recon.core.plugins import SENSORS, registered_places

        paths = given.get("observations", ())
        if settings.reader is None and not registered_places(SENSORS):
            refuse_foreign_files(paths)
            if settings.up is None:
                refuse_unknown_markers(paths, settings.mapping, settings.unit)
    recording = given.get("recording", given.get("trial"))
    is_motion = "trial" in given and recording.suffix.lower() == ".npz"
    if recording is not None and not is_motion and given.get("mapping") is None:
        refuse_unknown_recording(recording, given["unit"], given["up"])


def refuse_foreign_files(paths: Sequence[Path]) -> None:
    """Refuse files that cannot be fitted, judged by program, suffix and first bytes.

    Raises:
        ValueError: says what was seen and what would fit.
    """
    from recon.core.errors import FormatError
    from recon.formats.producers import producer_of, refuse_unsupported

    for path in paths:
        refuse_unsupported(path, "fit")
        if not path.is_file():
            continue
        with path.open("rb") as file:
            head = file.read(_HEAD)
        if len(head) == 0:
            raise FormatError(f"{path}: the file is empty")
        wrong = _reason_to_refuse(path, head, known_producer=producer_of(path) is not None)
        if wrong is not None:
            raise FormatError(f"{path}: {wrong}")


def _reason_to_refuse(path: Path, head: bytes, *, known_producer: bool) -> str | None:
    """Return why a file is unsuitable, by suffix and first bytes; None if it may be fitted."""
    ending = path.suffix.lower()
    text = head.decode("latin-1").lstrip("\ufeff\u00ef\u00bb\u00bf")
    first = repr(text.strip().splitlines()[0][:60]) if text.strip() else "nothing"
    match ending:
        case ".npz" if not is_zipfile(path):
            return "expected an .npz file of plain arrays, but it cannot be read"
        case ".npy" if not head.startswith(b"\x93NUMPY"):
            return "expected an .npy file, got other bytes"
        case ".c3d" if head[1:2] != b"\x50":
            return "expected a C3D file, whose second byte is 0x50"
        case ".trc" if not text.lower().startswith("pathfiletype"):
            return f"expected a TRC file, whose first line is PathFileType; got {first}"
        case ".csv" if not known_producer:
            return (
                "expected a table of keypoints: columns such as left_hip_x, left_hip_y, "
                "left_hip_z, or frame, keypoint, x, y, z, or DeepLabCut's header rows scorer, "
                f"bodyparts, coords; got {first}"
            )
        case ".json" if text.lstrip()[:1] not in ("{", "["):
            return "expected JSON, which begins with { or ["
        case ".json" if len(head) < _HEAD and not known_producer:
            return (
                "expected keypoints in JSON (people, annots, keypoints, landmarks, bodies, "
                f"names); got {text[:60]!r}"
            )
        case _ if known_producer or ending in (".npz", ".npy", ".json"):
            return None
        case _:
            return f"files ending in {ending or 'nothing'} are not known; expected {EXPECTED}"


def refuse_unknown_recording(path: Path, unit: str | None, up: str | None) -> None:
    """Refuse a recording whose skeleton or markers recon does not know.

    Raises:
        ValueError: says what was seen, and which mapping file to write.
    """
    from recon.formats.producers import refuse_unsupported
    from recon.mocap.reader import refuse_unknown_skeleton

    refuse_unsupported(path, "convert")
    refuse_unknown_skeleton(path)
    if up is None:
        refuse_unknown_markers([path], None, unit)


def refuse_unknown_markers(paths: Sequence[Path], mapping: Path | None, unit: str | None) -> None:
    """Refuse recordings that cannot be read or have too few known markers.

    With a mapping, and for files of other kinds, nothing is done. Callers who know the up axis
    need no look, which would ask for it.

    Raises:
        ValueError: says what was seen, and which mapping file to write.
    """
    marked = [one for one in paths if one.name.lower().endswith(_ENDINGS) and one.is_file()]
    if mapping is not None or not marked:
        return
    import numpy as np

    from recon.body.marker_labels import (
        FEWEST_MARKERS,
        advice_on_mapping,
        are_nameless,
        match_markers,
    )
    from recon.core.errors import FormatError
    from recon.keypoints3d.labels import STUDY, are_keypoints
    from recon.mocap.reader import read_recording
    from recon.mocap.recording import MarkerRecording

    for path in marked:
        recording = read_recording(path, unit=unit)
        assert isinstance(recording, MarkerRecording)
        shown = np.flatnonzero(recording.visible.sum(0))
        labels = [recording.marker_names[k] for k in shown]
        if are_keypoints(labels) or any(label.endswith(STUDY) for label in labels):
            continue
        if are_nameless(labels):
            continue
        known, unknown = match_markers(labels)
        if len(known) < FEWEST_MARKERS:
            raise FormatError(
                f"{path}: expected at least {FEWEST_MARKERS} markers of known places, got "
                f"{len(known)} ({', '.join(known) or 'none'}); labels not known: "
                f"{', '.join(unknown[:12])}{', ...' if len(unknown) > 12 else ''}; "
                f"{advice_on_mapping(unknown)}"
            )


def check_plugins(prior: str, reader: str | None) -> None:
    """Refuse unknown priors and readers; "module:Class" may be in the current folder.

    The folder comes last in Python's search, so that its files take no installed module's place.

    Raises:
        ValueError: names the priors there are.
    """
    known = registered_places(PRIORS)
    if prior not in known and ":" not in prior:
        near = get_close_matches(prior, known, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise ValueError(
            f"there is no prior {prior}{hint}; expected {', '.join(known)}, or "
            "package.module:Class of your own"
        )
    if reader is not None and ":" not in reader:
        raise ValueError(f"--reader takes package.module:Class, got {reader}")
    allow_current_folder((prior, reader or ""))


def allow_current_folder(names: Iterable[str]) -> None:
    """Make the current folder importable if any name has the form "module:Class"."""
    if any(":" in name for name in names) and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
