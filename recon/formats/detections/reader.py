"""2D keypoints of one camera, whoever wrote them: the reader is chosen by what the file holds."""

from pathlib import Path
from typing import Any

from recon.core.errors import FormatError
from recon.formats.detections.people import (
    alphapose_rows,
    easymocap_rows,
    is_alphapose,
    is_easymocap,
    is_mediapipe,
    is_mmpose,
    is_openpose,
    mediapipe_rows,
    mmpose_rows,
    openpose_rows,
)
from recon.formats.detections.records import Detections, gather
from recon.formats.detections.tables import (
    is_sleap,
    read_deeplabcut,
    read_detection_arrays,
    read_sleap,
)
from recon.formats.json_files import Frames, listed_frames, read_frame_folder, read_json
from recon.formats.opening import existing

_LISTS = ("instance_info", "predictions", "frames")
"""Keys under which a file with all frames keeps them."""
_EXPECTED = (
    "OpenPose (people), EasyMocap (annots), MMPose or rtmlib (keypoints with scores), AlphaPose "
    "(image_id with keypoints) or MediaPipe (landmarks)"
)


def read_keypoints(
    path: Path, *, layout: str | None = None, image_size: tuple[int, int] | None = None
) -> Detections:
    """Read a folder with a JSON file per frame, a JSON file of all, a CSV table or arrays.

    Args:
        path: OpenPose, Pose2Sim, EasyMocap, MMPose, rtmlib, AlphaPose, MediaPipe, DeepLabCut,
            SLEAP (.csv), or arrays `keypoints` with `scores` (.npz).
        layout: which keypoints; None to tell it from the file.
        image_size: width and height, pixels; needed for fractions of an image alone.

    Raises:
        FileNotFoundError: when there is nothing there.
        ValueError: when it is damaged, of no known producer, holds nobody, or its layout cannot
            be told.
    """
    name = str(path)
    if path.is_dir():
        frames = read_frame_folder(path)
        if any(is_alphapose(entry) for _, entry in frames):
            raise FormatError(f"{path}: give AlphaPose's file itself, not its folder")
        return _from_frames(frames, name, layout, image_size)
    existing(path)
    if path.suffix.lower() == ".csv":
        read = read_sleap if is_sleap(path) else read_deeplabcut
        return read(path, layout=layout)
    if path.suffix.lower() == ".npz":
        return read_detection_arrays(path, layout=layout)
    if path.suffix.lower() != ".json":
        raise FormatError(
            f"{path}: expected a folder of .json files, a .json file, a .csv table or a .npz of "
            "keypoints"
        )
    value = read_json(path)
    if is_alphapose(value):
        numbers, rows = alphapose_rows(value, name)
        return gather(name, numbers, rows, layout=layout)
    if isinstance(value, dict):
        value = next((value[key] for key in _LISTS if key in value), [value])
    if isinstance(value, list) and _is_one_frame(value):
        value = [value]
    if not isinstance(value, list):
        raise FormatError(f"{path}: expected {_EXPECTED}")
    return _from_frames(listed_frames(value, name), name, layout, image_size)


def _is_one_frame(value: list[Any]) -> bool:
    """A list of instances or landmarks, rather than a list of frames."""
    instances = all(isinstance(one, dict) and "keypoint_scores" in one for one in value)
    landmarks = all(isinstance(one, dict) and {"x", "y"} <= one.keys() for one in value)
    return len(value) > 0 and (instances or landmarks)


def _from_frames(
    frames: Frames, name: str, layout: str | None, image_size: tuple[int, int] | None
) -> Detections:
    entry = next((entry for _, entry in frames if _has_people(entry)), None)
    if entry is None and not any(_is_known_empty(entry) for _, entry in frames):
        raise FormatError(f"{name}: expected {_EXPECTED}")
    if entry is None:
        rows = []
    elif is_openpose(entry):
        rows = openpose_rows(frames, name)
    elif is_easymocap(entry):
        rows = easymocap_rows(frames, name)
    elif is_mediapipe(entry):
        rows = mediapipe_rows(frames, image_size, name)
        layout = layout or "mediapipe33"
    else:
        rows = mmpose_rows(frames, name)
    return gather(name, [number for number, _ in frames], rows, layout=layout)


def _has_people(entry: Any) -> bool:
    if is_openpose(entry) or is_easymocap(entry):
        return True
    return is_mediapipe(entry) or is_mmpose(entry)


def _is_known_empty(entry: Any) -> bool:
    return not entry or (isinstance(entry, dict) and entry.get("instances") == [])
