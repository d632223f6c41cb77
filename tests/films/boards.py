"""Rendered films of a checkerboard before cameras whose lenses and poses are known."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from recon.films.board import Board
from recon.formats.cameras import CameraArrays
from tests.films.painted import write

BOARD = Board(7, 4, 0.05)
SIZE = (480, 360)
FOCAL, DISTORTION = 430.0, np.array([-0.12, 0.05, 0.002, -0.001, 0.0])
TURN = 0.6
"""Radians from one camera to the other about the vertical."""
MOMENTS, STILL, RATE = 26, 8, 5
"""Pictures in which the board is moved, those in which it lies on the floor, and their rate."""
NOISE = 2.0
"""Grey levels, of 255."""
SIDE = 2
"""Points along each side of a pixel whose mean is its grey level."""


def camera(turn: float, focal: float) -> CameraArrays:
    """A camera 0.8 m from the middle, 0.9 m above the floor, that looks at it."""
    place = np.array([0.8 * np.sin(turn), -0.8 * np.cos(turn), 0.9])
    ahead = np.array([0.0, 0.0, 0.2]) - place
    ahead /= np.linalg.norm(ahead)
    aside = np.cross(ahead, (0.0, 0.0, 1.0))
    aside /= np.linalg.norm(aside)
    pose = np.eye(4)
    pose[:3, :3] = np.stack((aside, np.cross(ahead, aside), ahead))
    pose[:3, 3] = -pose[:3, :3] @ place
    return CameraArrays(camera_matrix(focal), SIZE, DISTORTION, pose[None])


def camera_matrix(focal: float) -> np.ndarray:
    return np.array([[focal, 0.0, 236.0], [0.0, focal, 184.0], [0.0, 0.0, 1.0]])


@cache
def camera_rays(focal: float) -> np.ndarray:
    """Rays through four points of every pixel; those of one lens serve all of its pictures."""
    y, x = (np.mgrid[: SIZE[1] * SIDE, : SIZE[0] * SIDE] + 0.5) / SIDE - 0.5
    pixels = np.stack((x, y), -1).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(pixels, camera_matrix(focal), DISTORTION)[:, 0]
    return np.column_stack((flat, np.ones(len(flat))))


def board_poses() -> list[np.ndarray]:
    """T_world_board: tilted each way in the air, then flat on the floor, its face up."""
    out = []
    middle = np.array([3 * BOARD.square, 1.5 * BOARD.square, 0.0])
    for k in range(MOMENTS + STILL):
        flat = k >= MOMENTS
        tilt = (0.0, 0.0) if flat else (np.radians(35) * np.sin(0.9 * k), 0.6 * np.cos(1.3 * k))
        lean = 0.0 if flat else np.radians(45)
        turn = Rotation.from_euler(
            "zyx", [TURN / 2 + 0.3 * np.sin(k), tilt[1], np.pi + lean + tilt[0]]
        )
        at = np.array([0.14 * np.sin(1.7 * k), 0.1 * np.cos(2.1 * k), 0.35 + 0.1 * np.sin(k)])
        if flat:
            turn, at = Rotation.from_euler("zx", [0.4, np.pi]), np.zeros(3)
        pose = np.eye(4)
        pose[:3, :3] = turn.as_matrix()
        pose[:3, 3] = at - pose[:3, :3] @ middle
        out.append(pose)
    return out


def picture(
    seen_by: CameraArrays, T_world_board: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """What a camera sees of the board."""
    assert seen_by.T_camera_world is not None
    T = seen_by.T_camera_world[0] @ T_world_board
    rays = camera_rays(seen_by.camera_matrix[0, 0]) @ T[:3, :3]
    start = -T[:3, :3].T @ T[:3, 3]
    on = start[:2] + rays[:, :2] * (-start[2] / rays[:, 2])[:, None]
    column, row = np.floor(on[:, :2] / BOARD.square).astype(int).T
    dark = (column + row) % 2 == 0
    inside = (column >= -1) & (column < BOARD.columns) & (row >= -1) & (row < BOARD.rows)
    margin = (column >= -2) & (column <= BOARD.columns) & (row >= -2) & (row <= BOARD.rows)
    grey = np.where(inside, np.where(dark, 25.0, 230.0), np.where(margin, 235.0, 120.0))
    image = grey.reshape(SIZE[1], SIDE, SIZE[0], SIDE).mean((1, 3))
    image += rng.normal(0, NOISE, image.shape)
    return np.repeat(image.round().clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


def film(path: Path, seen_by: CameraArrays) -> Path:
    """The film of a camera."""
    rng = np.random.default_rng(0)
    return write(path, [picture(seen_by, one, rng) for one in board_poses()], RATE)
