"""Reads 2D keypoints of one camera; the format is recognised by the file's content."""

from pathlib import Path

from recon.core.errors import FormatError
from recon.detections.json_files import is_alphapose, read_frames, read_json_detections
from recon.detections.records import Detections
from recon.detections.tables import (
    is_sleap,
    read_deeplabcut,
    read_detection_arrays,
    read_sleap,
)
from recon.formats.json_files import read_frame_folder, read_json
from recon.formats.opening import existing_file


def read_keypoints(
    path: Path, *, layout: str | None = None, image_size: tuple[int, int] | None = None
) -> Detections:
    """Read a folder with a JSON file per frame, one JSON file, a CSV table or arrays.

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
    if path.is_dir():
        frames = read_frame_folder(path)
        if any(is_alphapose(entry) for _, entry in frames):
            raise FormatError(f"{path}: expected AlphaPose's file, got its folder; give the file")
        return read_frames(frames, str(path), layout, image_size)
    existing_file(path)
    match path.suffix.lower():
        case ".csv":
            return (read_sleap if is_sleap(path) else read_deeplabcut)(path, layout)
        case ".npz":
            return read_detection_arrays(path, layout)
        case ".json":
            return read_json_detections(read_json(path), str(path), layout, image_size)
    raise FormatError(
        f"{path}: expected a folder of .json files, a .json file, a .csv table or a .npz of "
        "keypoints"
    )
