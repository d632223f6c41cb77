"""Finds the files and settings that a fit needs in projects of Pose2Sim and OpenCap.

Pose2Sim keeps a trial as `Config.toml`, `pose*/CAMERA_json/*.json`, `pose-3d/*.trc` and `videos`;
what a trial's Config.toml does not say, that of the participant or session above it does, and the
calibration, `*calib*/*.toml`, lies beside the trial or above it (Pose2Sim 0.10, Config.toml of
its demonstration and `triangulation.py`). OpenCap's sessions hold `sessionMetadata.yaml`,
`MarkerData/TRIAL.trc` and `Videos/Cam*/cameraIntrinsicsExtrinsics.pickle` (opencap-core,
`utils.py`, `main.py`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.core.errors import FormatError, ObservationError
from recon.core.limits import FRAME_NUMBER, FRAME_RATE
from recon.formats.texts import decoded_text, read_toml

_POSES = ("pose-associated", "pose-sync", "pose")
"""Folders of 2D detections of Pose2Sim; those after association with a person come first."""
_LEVELS = 3
"""Number of nested folders (trial, participant, session) that may hold a Config.toml."""
_CONFIG = "Config.toml"
_TRC_HEADER = 4096
"""Number of bytes at the start of a .trc file among which its frame rate is."""
_METADATA = "sessionMetadata.yaml"


@dataclass(frozen=True)
class Project:
    """Files and settings of one trial of a Pose2Sim or OpenCap project."""

    folder: Path
    detections: Path | None
    """Folder with a folder of 2D detections per camera; None where there is none."""
    points: Path | None
    """Table of 3D keypoints (.trc); None where there is none."""
    calibration: Path | None
    fps: float | None
    """Frames per second; None where nothing in the project states them."""
    frames: tuple[int, int] | None
    """Numbers of the first frame and of the one after the last; None for all frames."""
    read: tuple[Path, ...]
    """Configuration and calibration files of the project that were read."""
    decisions: tuple[str, ...]


def project_at(folder: Path) -> Project | None:
    """Read a folder as a project of Pose2Sim or OpenCap; None if it is neither.

    Raises:
        ValueError: when it holds several trials or calibrations, or its settings are damaged;
            names them.
    """
    if not folder.is_dir():
        return None
    if (folder / _METADATA).is_file() or (folder / "MarkerData").is_dir():
        return _opencap_project(folder)
    if any((folder / name).is_dir() for name in (*_POSES, "pose-3d")):
        return _pose2sim_project(folder)
    if (folder / _CONFIG).is_file():
        trials = sorted(
            one.parent for depth in ("*", "*/*") for one in folder.glob(f"{depth}/pose*")
            if one.is_dir()
        )  # fmt: skip
        if trials:
            names = dict.fromkeys(str(one.relative_to(folder)) for one in trials)
            raise ObservationError(
                f"{folder}: a session of {len(names)} trials; give one of them: {', '.join(names)}"
            )
    return None


def _pose2sim_project(folder: Path) -> Project | None:
    levels = [folder, *folder.resolve().parents][:_LEVELS]
    configs = [level / _CONFIG for level in levels if (level / _CONFIG).is_file()]
    # without a configuration file, folders above do not belong to the project
    calibration = _calibration_file(levels if configs else levels[:1])
    detections = next((folder / name for name in _POSES if (folder / name).is_dir()), None)
    points = _triangulated_points_file(folder)
    if not configs and calibration is None and points is None:
        return None  # a folder of detections without a project
    stated: dict[str, Any] = {}
    # configurations of inner folders override those of outer ones
    for config in reversed(configs):
        stated |= _project_table(config)
    said = [f"Pose2Sim project: {folder}"]
    if calibration is not None:
        said.append(f"calibration: {calibration}")
    fps, fps_said = _frame_rate(stated.get("frame_rate", "auto"), folder, points)
    said += [] if fps_said is None else [fps_said]
    frames = _frame_range(stated.get("frame_range"), folder)
    if frames is not None:
        said.append(f"frames {frames[0]} to {frames[1] - 1}: frame_range of {_CONFIG}")
    if detections is None and points is not None:
        said.append(f"no 2D detections: the 3D keypoints of {points.name} are fitted")
    read = (*configs, *([] if calibration is None else [calibration]))
    return Project(folder, detections, points, calibration, fps, frames, read, tuple(said))


def _project_table(config: Path) -> dict[str, Any]:
    found = read_toml(config).get("project", {})
    return found if isinstance(found, dict) else {}


def _calibration_file(folders_upwards: list[Path]) -> Path | None:
    """Find the calibration file in the first of the folders, from inside out, that has one.

    Raises:
        ValueError: when that folder has several.
    """
    for level in folders_upwards:
        folders = [one for one in sorted(level.iterdir()) if one.is_dir()]
        folders = [one for one in folders if "calib" in one.name.lower()]
        files = [path for one in folders for path in sorted(one.glob("*.toml"))]
        files += sorted(one for one in level.glob("[Cc]alib*.toml"))
        if len(files) > 1:
            raise ObservationError(
                f"{level}: several calibrations, {', '.join(one.name for one in files)}; give one "
                "with --camera"
            )
        if files:
            return files[0]
    return None


def _triangulated_points_file(folder: Path) -> Path | None:
    """Find the file of triangulated keypoints, unfiltered if possible, since fits smooth."""
    found = sorted((folder / "pose-3d").glob("*.trc"))
    raw = [one for one in found if "filt" not in one.name and "_LSTM" not in one.name]
    chosen = raw or found
    return chosen[0] if len(chosen) == 1 else None


def _frame_rate(stated: Any, folder: Path, points: Path | None) -> tuple[float | None, str | None]:
    """Find frames per second in Config.toml, the 3D keypoints or a video; return a note, too."""
    if isinstance(stated, int | float) and not isinstance(stated, bool):
        fps = float(stated)
        FRAME_RATE.check(fps, folder / _CONFIG, "frame_rate")
        return fps, f"{fps:g} frames per second: frame_rate of {_CONFIG}"
    if points is not None and (fps := _trc_rate(points)) is not None:
        return fps, f"{fps:g} frames per second: by {points.name}"
    for video in sorted((folder / "videos").glob("*")) if (folder / "videos").is_dir() else []:
        if (fps := _video_rate(video)) is not None:
            return fps, f"{fps:g} frames per second: by {video.name}"
    return None, None


def _trc_rate(path: Path) -> float | None:
    if not path.is_file():  # reading a pipe would never end
        return None
    with path.open("rb") as file:
        lines = decoded_text(file.read(_TRC_HEADER)).splitlines()
    if len(lines) < 3:
        return None
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    try:
        fps = float(header.get("DataRate", ""))
    except ValueError:
        return None
    return fps if FRAME_RATE.holds(fps) else None


def _video_rate(path: Path) -> float | None:
    """Read frames per second of a video, rounded as Pose2Sim does; None for other files."""
    import cv2

    if not path.is_file():
        return None
    video = cv2.VideoCapture(str(path))
    fps = float(round(video.get(cv2.CAP_PROP_FPS))) if video.isOpened() else 0.0
    video.release()
    return fps if FRAME_RATE.holds(fps) else None


def _frame_range(stated: Any, folder: Path) -> tuple[int, int] | None:
    if stated in (None, "auto", "all") or stated == []:
        return None
    whole = isinstance(stated, list) and len(stated) == 2 and all(type(k) is int for k in stated)
    if not whole or not 0 <= stated[0] < stated[1]:
        raise FormatError(
            f"{folder / _CONFIG}: expected 'auto', 'all' or two rising numbers in frame_range, "
            f"got {str(stated)[:60]}"
        )
    FRAME_NUMBER.check(stated[1], folder / _CONFIG, "frame_range")
    return stated[0], stated[1]


def _opencap_project(folder: Path) -> Project:
    markers = folder / "MarkerData"
    trials = sorted(markers.glob("*.trc")) or sorted(markers.glob("*/*.trc"))
    moving = [one for one in trials if one.stem.lower() not in ("neutral", "static")]
    chosen = moving or trials
    if len(chosen) != 1:
        listed = ", ".join(str(one.relative_to(folder)) for one in trials) or "none"
        raise ObservationError(
            f"{folder}: an OpenCap session; expected one trial in MarkerData, give one of its "
            f"files: {listed}"
        )
    said = [f"OpenCap session: {folder}, trial {chosen[0].stem}"]
    if any(folder.glob("Videos/Cam*/*.pickle")):
        said.append(
            "cameraIntrinsicsExtrinsics.pickle was not opened, as pickles may run code; 3D "
            "keypoints need no cameras"
        )
    return Project(folder, None, chosen[0], None, None, None, (), tuple(said))
