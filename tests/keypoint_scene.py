"""A walking stick figure in front of calibrated cameras, and its files as detectors write them."""

import json
from pathlib import Path

import cv2
import numpy as np

from recon.core.layouts import keypoint_names
from recon.formats.observations import CameraArrays

SIZE = (1280, 720)
_PLACES = {
    "nose": (0.1, 0, 1.6), "eye": (0.08, 0.03, 1.65), "ear": (0, 0.07, 1.63),
    "neck": (0, 0, 1.45), "upper_neck": (0, 0, 1.5), "head_top": (0, 0, 1.75),
    "shoulder": (0, 0.18, 1.42),
    "elbow": (0, 0.22, 1.14), "wrist": (0.05, 0.24, 0.9), "mid_hip": (0, 0, 0.93),
    "hip": (0, 0.1, 0.93), "knee": (0.03, 0.11, 0.5), "ankle": (0, 0.11, 0.09),
    "heel": (-0.05, 0.11, 0.04), "big_toe": (0.15, 0.1, 0.02), "small_toe": (0.13, 0.16, 0.02),
}  # fmt: skip
"""Metres: x forward, y left, z up."""


def figure(layout: str, place: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Keypoints of a standing person, metres."""
    out = []
    for name in keypoint_names(layout):
        side, _, part = name.partition("_")
        if side in ("left", "right"):
            x, y, z = _PLACES[part]
            out.append((x, y if side == "left" else -y, z))
        else:
            out.append(_PLACES[name])
    return np.array(out) + np.array((*place, 0.0))


def camera(angle: float, distance: float = 4.0) -> CameraArrays:
    """A camera at an angle (degrees) about the origin, 1.2 m high, looking at the axis."""
    a = np.deg2rad(angle)
    eye = np.array([distance * np.cos(a), distance * np.sin(a), 1.2])
    forward = np.array([-np.cos(a), -np.sin(a), -0.05])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack((right, np.cross(forward, right), forward))
    pose[:3, 3] = -pose[:3, :3] @ eye
    matrix = np.array([[900.0, 0, 640], [0, 900.0, 360], [0, 0, 1]])
    distortion = np.array([-0.05, 0.01, 0.001, -0.001])
    return CameraArrays(matrix, SIZE, distortion, pose[None])


def image(points: np.ndarray, seen_by: CameraArrays, confidence: float = 0.9) -> np.ndarray:
    """x, y, confidence of points in a camera, by OpenCV."""
    assert seen_by.T_camera_world is not None
    pose = seen_by.T_camera_world[0]
    turn = np.asarray(cv2.Rodrigues(pose[:3, :3])[0])
    pixels = cv2.projectPoints(
        points, turn, pose[:3, 3], seen_by.camera_matrix, seen_by.distortion
    )[0].reshape(-1, 2)
    return np.concatenate((pixels, np.full((len(pixels), 1), confidence)), 1)


def write_openpose(folder: Path, frames: list[list[np.ndarray]], first: int = 0) -> Path:
    """One file per frame with these people."""
    folder.mkdir(parents=True)
    for t, people in enumerate(frames):
        record = {"version": 1.3, "people": [
            {"person_id": [-1], "pose_keypoints_2d": person.ravel().tolist()} for person in people
        ]}  # fmt: skip
        path = folder / f"{folder.name}_{first + t:012d}_keypoints.json"
        path.write_text(json.dumps(record))
    return folder


def write_toml(path: Path, cameras: dict[str, CameraArrays], scale: float = 1.0) -> Path:
    """Calib.toml with translations in metres times a scale."""
    lines = []
    for name, one in cameras.items():
        assert one.T_camera_world is not None
        assert one.distortion is not None
        pose = one.T_camera_world[0]
        turn = np.asarray(cv2.Rodrigues(pose[:3, :3])[0]).ravel()
        lines += [
            f"[{name}]", f'name = "{name}"', f"size = {[float(n) for n in one.image_size]}",
            f"matrix = {one.camera_matrix.tolist()}", f"distortions = {one.distortion.tolist()}",
            f"rotation = {turn.tolist()}", f"translation = {(pose[:3, 3] * scale).tolist()}",
            "fisheye = false", "",
        ]  # fmt: skip
    path.write_text("\n".join([*lines, "[metadata]", "adjusted = false"]))
    return path
