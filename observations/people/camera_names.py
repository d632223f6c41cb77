"""Names of files that are views, and the camera that each belongs to."""

import re
from collections.abc import Sequence
from pathlib import Path

from recon.core.errors import ObservationError

_FOLDERS = ("annots", "pose-associated", "pose-sync", "pose", "openpose", "json")
"""Folders in which projects of EasyMocap and Pose2Sim keep those of their cameras; the first
wins."""
_SAME = {"camera": "cam", "view": "cam", "c": "cam"}
_NOISE = {"json", "keypoints", "pose", "mp4", "avi", "mov", "openpose"}


def expand(paths: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """The views that files and folders stand for, and what was decided about folders.

    A file is a view, and so is a folder of .json files. A folder of such folders, or of one .csv
    table per camera, stands for them; a project for those of its first folder among `annots`,
    `pose-associated`, `pose-sync`, `pose`.

    Raises:
        FileNotFoundError: when something is not there.
        ValueError: when a folder holds no views, or there are none at all.
    """
    views: list[Path] = []
    notes: list[str] = []
    for path in paths:
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file or folder")
        inside = [path] if path.is_file() or _holds(path, ".json") else _inside(path)
        project = next((path / name for name in _FOLDERS if (path / name).is_dir()), None)
        if len(inside) == 0 and project is not None:
            inside = [project] if _holds(project, ".json") else _inside(project)
        if len(inside) == 0:
            raise ObservationError(
                f"{path}: expected .json files of one camera, or a folder per camera with them"
            )
        if inside != [path]:
            notes.append(f"{path}: {len(inside)} views, {', '.join(str(one) for one in inside)}")
        views += inside
    if len(views) == 0:
        raise ObservationError("expected at least one file or folder of keypoints")
    return views, tuple(notes)


def view_name(path: Path) -> str:
    """The name under which a view is matched: of its folder, or of its file without ending."""
    return path.name if path.is_dir() else path.stem


def match_cameras(
    views: Sequence[str], cameras: Sequence[str], given: Sequence[str] | None
) -> tuple[list[str], tuple[str, ...]]:
    """The camera of every view, and what was matched with what.

    Names are the same when their words and numbers are: cam01_json, cam_01 and Camera 1. A view
    whose name contains that of exactly one camera (trial2_cam_01) belongs to it. One view and one
    camera belong together whatever their names.

    Raises:
        ValueError: when a view has no camera or two, two views have one, or a given camera is
            not in the calibration; the message lists both sides.
    """
    both = f"views: {', '.join(views)}; cameras: {', '.join(cameras)}"
    if given is not None:
        if len(given) != len(views):
            raise ObservationError(
                f"expected a camera name for each of {len(views)} views; {both}"
            )
        if unknown := [name for name in given if name not in cameras]:
            raise ObservationError(f"no camera {', '.join(unknown)} in the calibration; {both}")
        chosen = list(given)
    elif len(views) == len(cameras) == 1:
        chosen = list(cameras)
    else:
        found = [_matching(view, cameras) for view in views]
        for view, candidates in zip(views, found, strict=True):
            if len(candidates) != 1:
                which = " and ".join(candidates) or "no camera"
                raise ObservationError(
                    f"view {view} matches {which} by name; rename it or give the camera's name. "
                    f"There are {both}"
                )
        chosen = [candidates[0] for candidates in found]
    if twice := sorted({name for name in chosen if chosen.count(name) > 1}):
        same = [view for view, name in zip(views, chosen, strict=True) if name in twice]
        raise ObservationError(
            f"camera {', '.join(twice)} belongs to several views, {', '.join(same)}; give each "
            f"camera once. There are {both}"
        )
    notes = [f"view {view}: camera {name}" for view, name in zip(views, chosen, strict=True)]
    if unused := [name for name in cameras if name not in chosen]:
        notes.append(f"cameras without a view: {', '.join(unused)}")
    return chosen, tuple(notes)


def _matching(view: str, cameras: Sequence[str]) -> list[str]:
    words = _words(view)
    same = [name for name in cameras if _words(name) == words]
    return same or [name for name in cameras if _contains(words, _words(name))]


def _words(name: str) -> tuple[str, ...]:
    """Words and numbers of a name, in lower case and without leading zeros."""
    parts: list[str] = re.findall(r"[a-z]+|\d+", name.lower())
    words = [str(int(part)) if part.isdigit() else _SAME.get(part) or part for part in parts]
    return tuple(word for word in words if word not in _NOISE)


def _contains(words: tuple[str, ...], part: tuple[str, ...]) -> bool:
    size = len(part)
    return size > 0 and any(words[k : k + size] == part for k in range(len(words) - size + 1))


def _holds(folder: Path, suffix: str) -> bool:
    return any(one.suffix.lower() == suffix and one.is_file() for one in folder.iterdir())


def _inside(folder: Path) -> list[Path]:
    """Camera folders and tables of a folder, by name."""
    return sorted(
        one
        for one in folder.iterdir()
        if (one.is_dir() and _holds(one, ".json")) or one.suffix.lower() == ".csv"
    )
