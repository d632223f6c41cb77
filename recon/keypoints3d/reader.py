"""Reads 3D keypoints of one person; the format is recognised by the file's content."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.fingers import FINGER_POINTS, SIDES
from recon.core.layouts import LAYOUTS
from recon.core.limits import TEXT
from recon.core.units import Up
from recon.detections.tables import holds_detections
from recon.formats.json_files import read_frame_folder
from recon.formats.observations import PositionsFile
from recon.formats.opening import load_arrays
from recon.formats.producers import MARKERS, POINTS_3D, holds_sam3d_body, producer_of
from recon.formats.text_tables import first_rows, numbers_of_columns, read_rows
from recon.keypoints3d.json_files import read_json_points
from recon.keypoints3d.labels import STUDY, are_keypoints
from recon.keypoints3d.layouts import named_by_count
from recon.keypoints3d.people_files import read_ntu_skeleton, read_people
from recon.keypoints3d.records import Points3D
from recon.keypoints3d.tables import (
    is_table_3d,
    key_of_points,
    read_array,
    read_arrays,
    read_table,
)
from recon.mocap.recording import MarkerRecording

_BODY = ("mediapipe_body_3d_xyz", "body_3d_xyz", "*_body_3d_xyz")


def session_body_file(folder: Path) -> Path | None:
    """Return the file with the body keypoints of a FreeMoCap session; None for other folders."""
    places = (folder / "output_data", folder)
    endings = [(stem, ending) for stem in _BODY for ending in (".npy", ".csv")]
    found = (sorted(place.glob(stem + ending)) for place in places for stem, ending in endings)
    return next((files[0] for files in found if files), None)


def session_hand_files(body: Path) -> list[Path]:
    """Return the files of both hands beside the file of a session's body, or none of them."""
    found = [body.with_name(body.name.replace("body", f"{side}_hand", 1)) for side in SIDES]
    return found if all(one.exists() for one in found) else []


def session_time_stamps(folder: Path) -> Path | None:
    """Return the file with the time stamps of a FreeMoCap session's frames, or None."""
    places = (folder, folder / "output_data", folder.parent)
    return next((one for place in places for one in sorted(place.glob("*_by_frame.csv"))), None)


def read_session(folder: Path) -> Points3D:
    """Read the body's keypoints of a FreeMoCap session, millimetres, and its frame rate.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it is no session, or its files are damaged.
    """
    path = session_body_file(folder)
    if path is None:
        raise FormatError(
            f"{folder}: expected FreeMoCap's output_data with mediapipe_body_3d_xyz.npy or "
            "body_3d_xyz.csv"
        )
    points = _with_session_hands((read_array if path.suffix == ".npy" else read_table)(path), path)
    said = f"FreeMoCap session: {path.relative_to(folder)}, millimetres"
    points = replace(points, unit="mm", decisions=(*points.decisions, said))
    stamps = session_time_stamps(folder)
    if points.fps is not None or stamps is None:
        return points
    header, *rows = read_rows(stamps, TEXT)
    header = [cell.lower() for cell in header]
    if not {"frame", "timestamp"} <= set(header):
        return points
    columns = [header.index("frame"), header.index("timestamp")]
    try:
        frames, times = numbers_of_columns(rows, columns, stamps.name, most=len(header)).T
    except FormatError:
        return points  # without a frame rate, which the user must then give
    first = np.unique(frames, return_index=True)[1]
    return points.with_rate_of_times(times[first], stamps.name)


def _with_session_hands(points: Points3D, path: Path) -> Points3D:
    """Add the hand points of a session's other files to MediaPipe's points of the body."""
    layout = LAYOUTS["mediapipe33"]
    parts = session_hand_files(path)
    if points.positions.shape[1] != len(layout) or not parts:
        return points
    hands = [(read_array if one.suffix == ".npy" else read_table)(one).positions for one in parts]
    if any(one.shape != (len(points.positions), 21, 3) for one in hands):
        raise FormatError(
            f"{path}: expected 21 points of each hand in {len(points.positions)} frames beside "
            f"the body, got {', '.join(str(one.shape) for one in hands)}"
        )
    positions = np.concatenate((points.positions, *hands), 1)
    return replace(points, positions=positions, names=(*layout, *FINGER_POINTS))


_TABLES = (".csv", ".tsv", ".txt")
_HEAD = 1 << 16
"""Bytes at the start of a JSON file that show of which kind it is."""


def holds_points_3d(path: Path, *, images: bool = False) -> bool:
    """Whether a file or folder holds 3D keypoints.

    Args:
        path: of the file or folder.
        images: whether a camera was given, so that landmarks which a file has both in the image
            and in space are those of the image.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it must be read to be told, and is damaged.
    """
    ending, found = path.suffix.lower(), producer_of(path)
    if ending == ".npz" and path.is_file() and not holds_sam3d_body(path):
        if holds_detections(path):
            return False
        arrays = load_arrays(path)
        # the `joints` of a motion file are results, not observations
        others = "kind" in arrays or {"trans", "poses"} <= arrays.keys()
        return not others and key_of_points(arrays) is not None
    if ending in _TABLES and path.is_file() and not holds_labelled_points(path):
        return is_table_3d(first_rows(path))
    if found is None or found.holds != POINTS_3D:
        return False
    if not images or ending != ".json":
        return True
    with path.open("rb") as file:
        return b"pose_landmarks" not in file.read(_HEAD)


def holds_labelled_points(path: Path) -> bool:
    """Return whether a file is a recording of labelled points, as markers or keypoints."""
    found = producer_of(path)
    return found is not None and found.holds == MARKERS


def read_points_3d(
    path: Path, *, unit: str | None = None, up: Up | None = None, person: int | None = None
) -> Points3D:
    """Read 3D keypoints: FreeMoCap, MediaPipe, SAM 3D Body, Anipose, arrays, tables, TRC, C3D.

    Args:
        path: of the file or session folder.
        unit: of a recording (.trc, .c3d), where the file is wrong about it.
        up: axis of a recording that points up, where it cannot be told.
        person: whom to take of several people (.json), from 0 on; None takes who is seen longest.

    Raises:
        FileNotFoundError: when there is nothing there.
        ValueError: when it is damaged, of no known kind or holds nobody.
    """
    if holds_sam3d_body(path):
        from recon.keypoints3d.sam3d_body import read_sam3d_body  # imported only for this format

        return read_sam3d_body(path, person).checked()
    if path.is_dir():
        alone = session_body_file(path) is None and holds_points_3d(path)
        found = read_people(read_frame_folder(path), path.name, person) if alone else None
        return named_by_count(read_session(path) if found is None else found).checked()
    match path.suffix.lower():
        case ".npy":
            found = read_array(path)
        case ".npz" | ".pkl":
            found = read_arrays(path)
        case _ if holds_labelled_points(path):
            found = points_of_recording(marker_recording(path, unit, up))
        case ".csv" | ".tsv" | ".txt":
            found = read_table(path)
        case ".json":
            found = read_json_points(path, person)
        case ".skeleton":
            found = read_ntu_skeleton(path, person)
        case _:
            raise FormatError(
                f"{path}: expected 3D keypoints as .npy, .npz, .csv, .json, .trc, .c3d or a "
                "session folder"
            )
    return named_by_count(found).checked()


def marker_recording(path: Path, unit: str | None, up: Up | None) -> MarkerRecording:
    """Read a recording of labelled points, in metres and z up.

    Raises:
        FileNotFoundError, ValueError: as `recon.mocap.reader.read_recording` does.
    """
    from recon.mocap.reader import read_recording  # imported only for recordings

    found = read_recording(path, unit=unit, up=up)
    if not isinstance(found, MarkerRecording):
        raise FormatError(f"{path}: expected points, got a skeleton; use `recon convert`")
    return found


def points_of_recording(recording: MarkerRecording) -> Points3D:
    """Convert a recording of labelled points to 3D keypoints.

    Raises:
        ValueError: when the labels are those of markers.
    """
    if not are_keypoints(recording.marker_names):
        raise FormatError(
            f"{recording.name}: expected keypoints such as LHip, RKnee, Nose; got "
            f"{', '.join(recording.marker_names[:8])}"
        )
    kept = [name for name in recording.marker_names if not name.endswith(STUDY)]
    said = recording.decisions
    if left := len(recording.marker_names) - len(kept):
        said = (*said, f"{left} markers that OpenCap computed from these keypoints were left out")
    recording = recording.select(kept)
    shown = np.where(recording.visible[..., None], recording.positions, np.nan)
    return Points3D(
        recording.name, shown, recording.marker_names, fps=recording.fps,
        start_time=recording.start_time, unit="m", decisions=said,
    ).checked()  # fmt: skip


def opencap_markers(recording: MarkerRecording) -> PositionsFile | None:
    """OpenCap's computed markers as markers on the skin; None for other recordings.

    Centres of hip joints among them are no markers and are left out.
    """
    computed = [name for name in recording.marker_names if name.endswith(STUDY)]
    if len(computed) < len(recording.marker_names):
        return None
    skin = [name for name in computed if "HJC" not in name]
    recording = recording.select(skin)
    return PositionsFile(
        kind="markers3d",
        positions=recording.positions,
        visible=recording.visible,
        names=tuple(name.removesuffix(STUDY) for name in skin),
        fps=recording.fps,
        start_time=recording.start_time,
        decisions=(*recording.decisions, f"{len(skin)} markers of OpenCap's augmenter"),
    )


def with_known_rate(points: Points3D, fps: float | None) -> Points3D:
    """Return the points with the frame rate that the caller gave, or else the file's.

    Raises:
        ValueError: when neither the caller nor the file states one.
    """
    if fps is not None:
        return replace(points, fps=fps)
    if points.fps is None:
        unused = [one for one in points.decisions if one.endswith("were not used")]
        raise FormatError(
            f"{points.name}: {(unused or ['nothing in the file states the frame rate'])[0]}; give "
            "frames per second with --frame-rate"
        )
    return points
