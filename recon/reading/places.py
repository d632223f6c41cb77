"""Sizes, distances and duplicates of detections in an image."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from recon.core.errors import ObservationError
from recon.core.layouts import keypoint_names
from recon.detections.records import Detections
from recon.detections.tables import holds_detections
from recon.formats.depth_images import read_mask
from recon.formats.json_files import frame_numbers
from recon.formats.observations import KeypointsFile
from recon.formats.opening import files_of
from recon.formats.producers import POINTS_3D, films_at, producer_of
from recon.reading.masks import PackedMask, read_packed_masks

FEWEST_KEYPOINTS = 4
"""Detections with fewer are no people."""
_PIECE = 0.15
"""Detections with hardly a keypoint in common, each so close to the last sight of somebody,
keypoint by keypoint, are pieces of one body."""


def body_size(
    pixels: Float[np.ndarray, "points 2"], confidence: Float[np.ndarray, " points"]
) -> float:
    """Diagonal of the box around the keypoints seen, pixels; at least one."""
    seen = pixels[confidence > 0]
    return max(float(np.linalg.norm(np.ptp(seen, axis=0))), 1.0) if len(seen) > 0 else 1.0


def size_of(detections: Detections, row: int) -> float:
    """Body size of a detection, pixels."""
    return body_size(detections.pixels[row], detections.confidence[row])


def log_trunk_length(detections: Detections, row: int) -> float:
    """Logarithm of the length of the trunk in the image, pixels; NaN where it is not seen."""
    names = keypoint_names(detections.layout)
    ends: list[np.ndarray] = []
    for part in ("shoulder", "hip"):
        pair = [names.index(f"{s}_{part}") for s in ("left", "right") if f"{s}_{part}" in names]
        if len(pair) < 2 or not (detections.confidence[row, pair] > 0).all():
            return float("nan")
        ends.append(detections.pixels[row, pair].mean(0))
    return float(np.log(max(np.linalg.norm(ends[0] - ends[1]), 1.0)))


def centre_of(detections: Detections, row: int) -> Float[np.ndarray, "1 2"]:
    """Mean place of the keypoints of a detection."""
    return detections.pixels[row, detections.confidence[row] > 0].mean(0, keepdims=True)


def keypoint_distance(detections: Detections, a: int, b: int) -> float:
    """Mean distance of the keypoints that two detections share, in body sizes; infinite if few."""
    both = (detections.confidence[a] > 0) & (detections.confidence[b] > 0)
    if both.sum() < FEWEST_KEYPOINTS:
        return float("inf")
    away = np.linalg.norm(detections.pixels[a, both] - detections.pixels[b, both], axis=-1).mean()
    return float(away) / _larger_size(detections, a, b)


def pose_change(detections: Detections, a: int, b: int) -> float:
    """Change of pose: `keypoint_distance` without the displacement common to all keypoints."""
    both = (detections.confidence[a] > 0) & (detections.confidence[b] > 0)
    if both.sum() < FEWEST_KEYPOINTS:
        return float("inf")
    away = detections.pixels[a, both] - detections.pixels[b, both]
    apart = np.linalg.norm(away - np.median(away, axis=0), axis=-1).mean()
    return float(apart) / _larger_size(detections, a, b)


def centre_distance(detections: Detections, a: int, b: int) -> float:
    """Distance of the centres of two detections, over the keypoints both show, in body sizes."""
    seen_a, seen_b = detections.confidence[a] > 0, detections.confidence[b] > 0
    both = seen_a & seen_b
    if both.sum() >= FEWEST_KEYPOINTS:
        seen_a = seen_b = both
    way = detections.pixels[a, seen_a].mean(0) - detections.pixels[b, seen_b].mean(0)
    return float(np.linalg.norm(way)) / _larger_size(detections, a, b)


def without_fragments(
    detections: Detections, rows: Sequence[int], last_rows: Sequence[int]
) -> list[int]:
    """Drop detections of a frame that show only a part of a person whom another one shows.

    Args:
        detections: of one view.
        rows: those of the frame.
        last_rows: the last detections of everybody seen before.
    """
    strength = detections.confidence.sum(1)
    near = {
        row: {own for own in last_rows if keypoint_distance(detections, own, row) < _PIECE}
        for row in rows
    }
    lesser: set[int] = set()
    for a in near:
        for b in near:
            apart = (detections.confidence[[a, b]] > 0).all(0).sum() < FEWEST_KEYPOINTS
            if near[a] & near[b] and apart and strength[a] < strength[b]:
                lesser.add(a)
    return [row for row in rows if row not in lesser]


def _larger_size(detections: Detections, a: int, b: int) -> float:
    return max(size_of(detections, a), size_of(detections, b))


_FOLDERS = ("annots", "pose-associated", "pose-sync", "pose", "openpose", "json")
"""Folders in which projects of EasyMocap and Pose2Sim keep those of their cameras; the first
wins."""
_SAME = {"camera": "cam", "view": "cam", "c": "cam"}
_NOISE = {"json", "keypoints", "pose", "mp4", "avi", "mov", "openpose"}


def files_of_views(paths: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """The files or folders of single views in some paths, and notes on how folders were read.

    A file is a view, and so is a folder of .json files. A folder of such folders, of films, or of
    one .csv table per camera, stands for them; a project for those of its first folder among
    `annots`, `pose-associated`, `pose-sync`, `pose`.

    Raises:
        FileNotFoundError: when something is not there.
        ValueError: when a folder holds no views, or there are none at all.
    """
    views: list[Path] = []
    notes: list[str] = []
    for path in paths:
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file or folder")
        inside = [path] if path.is_file() or files_of(path, (".json",)) else _views_in(path)
        for one in inside if inside != [path] else ():
            found = producer_of(one)
            # files of others may hold keypoints in the image beside those in space
            if found is not None and (found.name, found.holds) == ("EasyMocap", POINTS_3D):
                raise ObservationError(
                    f"{path}: expected keypoints in images of cameras, but {one.name} holds "
                    f"keypoints in space ({found.name}); give {one}"
                )
        inside = inside or films_at(path)
        project = next((path / name for name in _FOLDERS if (path / name).is_dir()), None)
        if len(inside) == 0 and project is not None:
            inside = [project] if files_of(project, (".json",)) else _views_in(project)
        if len(inside) == 0:
            raise ObservationError(
                f"{path}: expected .json files of one camera, or a folder per camera with them, "
                "or a .csv or .npz of keypoints for each; or scans (.ply, .pcd, .obj, .xyz, .npy)"
            )
        if inside != [path]:
            notes.append(f"{path}: {len(inside)} views, {', '.join(str(one) for one in inside)}")
        views += inside
    if len(views) == 0:
        raise ObservationError("expected at least one file or folder of keypoints")
    return views, tuple(notes)


def view_name(path: Path) -> str:
    """The name of a view: of its folder, or of its file without ending."""
    return path.absolute().name if path.is_dir() else path.stem


def match_cameras(
    views: Sequence[str], cameras: Sequence[str]
) -> tuple[list[str], tuple[str, ...]]:
    """The name of every view's camera, and a note that lists the matches.

    Names are the same when their words and numbers are: cam01_json, cam_01 and Camera 1. A view
    whose name contains that of exactly one camera (trial2_cam_01) belongs to it. One view and one
    camera belong together whatever their names.

    Raises:
        ValueError: when a view has no camera or two, or two views have one; the message lists
            both sides.
    """
    both = f"views: {', '.join(views)}; cameras: {', '.join(cameras)}"
    chosen = list(cameras) if len(views) == len(cameras) == 1 else []
    for view in views if not chosen else ():
        words = _words_of_name(view)
        same = [name for name in cameras if _words_of_name(name) == words]
        found = same or [name for name in cameras if _contains(words, _words_of_name(name))]
        if len(found) != 1:
            raise ObservationError(
                f"view {view} matches {' and '.join(found) or 'no camera'} by name; rename it, or "
                f"the camera in the calibration. There are {both}"
            )
        chosen += found
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


def _words_of_name(name: str) -> tuple[str, ...]:
    """Words and numbers of a name, in lower case and without leading zeros."""
    parts: list[str] = re.findall(r"[a-z]+|\d+", name.lower())
    words = [str(int(part)) if part.isdigit() else _SAME.get(part) or part for part in parts]
    return tuple(word for word in words if word not in _NOISE)


def _contains(words: tuple[str, ...], part: tuple[str, ...]) -> bool:
    size = len(part)
    return size > 0 and any(words[k : k + size] == part for k in range(len(words) - size + 1))


def _views_in(folder: Path) -> list[Path]:
    """Camera folders, tables and arrays of a folder, by name."""
    return sorted(
        one
        for one in folder.iterdir()
        if (one.is_dir() and files_of(one, (".json",)))
        or one.suffix.lower() == ".csv"
        or holds_detections(one)
    )


MARGIN = 8
"""Pixels by which a silhouette is widened: joints lie inside, ears and toes at the rim."""


@dataclass(frozen=True)
class Silhouettes:
    """Masks of one view, by frame number."""

    name: str
    images: Mapping[int, Path | PackedMask]
    """Image files, read when needed, or arrays of one bit per pixel."""

    def visible(self, frame: int) -> Bool[np.ndarray, "height width"] | None:
        """The pixels in which the person is seen; None for a frame without a mask.

        Raises:
            ValueError: when the image is damaged.
        """
        found = self.images.get(frame)
        if isinstance(found, PackedMask):
            return found.unpacked()
        return None if found is None else read_mask(found)


def load_silhouettes(path: str | Path) -> Silhouettes:
    """Masks from a folder of .png files numbered by frame, or an .npz file with `mask (T, H, W)`.

    Raises:
        FileNotFoundError: when there is nothing there.
        ValueError: when there are no images, their names do not number them, or the array is no
            mask.
    """
    path = Path(path)
    if path.is_dir():
        files = files_of(path, (".png",))
        if len(files) == 0:
            raise ObservationError(f"{path}: expected one .png mask per frame, found none")
        numbers = frame_numbers([one.stem for one in files], str(path))
        return Silhouettes(str(path), dict(zip(numbers, files, strict=True)))
    return Silhouettes(str(path), dict(enumerate(read_packed_masks(path))))


def inside_silhouettes(
    file: KeypointsFile, masks: Silhouettes, *, first_frame: int = 0
) -> KeypointsFile:
    """The observation without the keypoints that fall outside the silhouette of their frame.

    A silhouette is widened by `MARGIN` pixels. Keypoints outside the image go too; frames
    without a mask stay as they are; an empty mask hides the whole person.

    Args:
        file: 2D keypoints of the view.
        masks: of the same view, in its size.
        first_frame: frame number of the observation's first frame.

    Raises:
        ValueError: when no mask belongs to a frame of the observation, or the sizes differ.
    """
    import cv2

    frames = range(first_frame, first_frame + len(file.confidence))
    if not any(frame in masks.images for frame in frames):
        raise ObservationError(
            f"{masks.name}: no mask is of a frame from {frames[0]} to {frames[-1]}; masks are "
            f"numbered from {min(masks.images)} to {max(masks.images)}; number them by frame"
        )
    width, height = file.camera.image_size
    kernel = np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)
    hands = np.zeros((len(frames), 0, 3)) if file.fingers is None else file.fingers
    confidence = np.concatenate((file.confidence, hands[..., 2]), 1)
    for t, frame in enumerate(frames):
        visible = masks.visible(frame)
        if visible is None:
            continue
        if visible.shape != (height, width):
            raise ObservationError(
                f"{masks.name}, frame {frame}: expected a mask of {width} x {height} pixels, got "
                f"{visible.shape[1]} x {visible.shape[0]}"
            )
        wide = cv2.dilate(visible.astype(np.uint8), kernel) != 0
        places = np.concatenate((file.pixels[t], hands[t, :, :2]))
        column, row = np.floor(places).astype(np.int64).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        seen = wide[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        confidence[t, ~(inside & seen)] = 0.0
    confidence, of_hands = np.split(confidence, [file.confidence.shape[1]], 1)
    pixels = np.where(confidence[..., None] > 0, file.pixels, 0.0)
    fingers = None if file.fingers is None else np.where(of_hands[..., None] > 0, hands, 0.0)
    return replace(file, pixels=pixels, confidence=confidence, fingers=fingers)
