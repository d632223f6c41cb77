"""The vertical and the focal length that straight lines tell, in drawn rooms."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon.core.errors import FormatError
from recon.detections.records import Detections
from recon.detections.tables import detection_arrays, read_detection_arrays
from recon.films.vertical import Vertical, find_vertical, straight_segments
from recon.formats.cameras import guessed_camera
from recon.reading.stated import background_camera

SIZE, FOCAL, PHONE = (720, 1280), 1000.0, 960.0


def room(pitch: float, roll: float, seed: int = 0) -> np.ndarray:
    """An image of edges along three directions, of a camera that is tilted by these degrees."""
    chance = np.random.default_rng(seed)
    image = np.full((*SIZE, 3), 120, np.uint8)
    turn = camera_from_world(pitch, roll)
    heading = Rotation.from_euler("y", 33, degrees=True).as_matrix()
    for number in range(120):
        depth = chance.uniform(3, 8)
        middle = depth * np.array([*chance.uniform([-0.6, -0.35], [0.6, 0.35]), 1.0])
        arm = turn @ heading[:, number % 3]
        ends = middle + np.outer([-1, 1], arm * chance.uniform(0.2, 0.8))
        if (ends[:, 2] > 0.5).all():
            pixels = ends[:, :2] / ends[:, 2:] * FOCAL + (SIZE[1] / 2, SIZE[0] / 2)
            colour = tuple(map(int, chance.integers(0, 255, 3)))
            first, last = (tuple(map(int, np.round(one * 16))) for one in pixels)
            cv2.line(image, first, last, colour, 3, cv2.LINE_AA, 4)
    return image


def vertical_in(images: list[np.ndarray], focal: float, *, known: bool) -> Vertical | None:
    middle = np.array(SIZE[::-1]) / 2
    segments = [straight_segments(one) - middle for one in images]
    return find_vertical(segments, max(SIZE), focal, 0.0 if known else 0.3)


def camera_from_world(pitch: float, roll: float) -> np.ndarray:
    return Rotation.from_euler("zx", [roll, pitch], degrees=True).as_matrix()


def angle(up: np.ndarray, pitch: float, roll: float) -> float:
    """Degrees between a direction and the true vertical."""
    true = camera_from_world(pitch, roll) @ (0.0, -1.0, 0.0)
    return float(np.degrees(np.arccos(np.clip(up @ true, -1, 1))))


@pytest.mark.parametrize(("pitch", "roll"), [(20, 0), (-15, 8), (30, -20), (-25, 0)])
def test_lines_of_a_room_tell_vertical_and_focal_length(pitch: float, roll: float):
    found = vertical_in([room(pitch, roll)], PHONE, known=False)
    assert found is not None
    assert angle(found.up, pitch, roll) < 1.5
    assert found.focal == pytest.approx(FOCAL, rel=0.06)


def test_lines_of_two_verticals_tell_neither():
    """Half of the lines are of a room, half of furniture that stands askew."""
    middle = np.array(SIZE[::-1]) / 2
    one, other = (straight_segments(room(10, roll)) - middle for roll in (-15, 15))
    for known in (False, True):
        assert find_vertical([one], max(SIZE), FOCAL, 0.0 if known else 0.3) is not None
        both = [np.concatenate((one, other))]
        assert find_vertical(both, max(SIZE), FOCAL, 0.0 if known else 0.3) is None


def test_known_focal_length_is_kept():
    found = vertical_in([room(20, 5)], FOCAL, known=True)
    assert found is not None
    assert angle(found.up, 20, 5) < 1.5
    assert found.focal is None


def test_vertical_lines_alone_do_not_tell_the_focal_length():
    image = np.full((*SIZE, 3), 120, np.uint8)
    for x in range(60, 1280, 50):
        cv2.line(image, (x, 100 + x % 90), (x, 600 - x % 70), (30, 60, 90), 3)
    found = vertical_in([image], PHONE, known=False)
    assert found is not None
    assert found.focal is None
    assert angle(found.up, 0, 0) < 1.0


@pytest.mark.parametrize("seed", range(4))
def test_random_lines_tell_nothing(seed: int):
    chance = np.random.default_rng(seed)
    image = np.full((*SIZE, 3), 120, np.uint8)
    for _ in range(80):
        first = chance.uniform(0, SIZE[::-1])
        along = chance.uniform(0, np.pi)
        last = first + chance.uniform(60, 300) * np.array([np.cos(along), np.sin(along)])
        cv2.line(image, tuple(map(int, first)), tuple(map(int, last)), (20, 30, 200), 2)
    assert vertical_in([image], PHONE, known=False) is None


def test_empty_image_tells_nothing():
    assert vertical_in([np.zeros((*SIZE, 3), np.uint8)], PHONE, known=False) is None


def test_images_of_a_camera_that_turns_tell_nothing():
    turning = [room(15, roll) for roll in (-12, 0, 12)]
    assert vertical_in(turning, PHONE, known=False) is None


def detections(lines: np.ndarray) -> Detections:
    """What is found of somebody in one frame of a film with these lines."""
    return Detections(
        name="film.mp4", layout="mediapipe33", frame_numbers=np.arange(1), frame=np.zeros(1, int),
        pixels=np.full((1, 33, 2), 300.0), confidence=np.ones((1, 33)), identity=np.zeros(1, int),
        lines=lines, lines_frame=np.zeros(len(lines), int),
    )  # fmt: skip


def test_camera_of_a_film_is_levelled_by_its_lines():
    seen = detections(straight_segments(room(20, 5)))
    camera, said = background_camera(seen, guessed_camera(SIZE[::-1]), np.arange(1), 30.0)
    assert camera.path is not None
    assert camera.path.level
    assert angle(-camera.path.T_world_camera[0, :3, :3].T @ (0.0, 0.0, -1.0), 20, 5) < 1.5
    assert camera.focal_known
    assert camera.camera_matrix[0, 0] == pytest.approx(FOCAL, rel=0.06)
    assert camera.camera_matrix[:2, 2] == pytest.approx([SIZE[1] / 2, SIZE[0] / 2])
    assert "degrees down" in said


def test_camera_whose_pose_is_known_keeps_it():
    seen = detections(straight_segments(room(20, 5)))
    posed = replace(guessed_camera(SIZE[::-1]), T_camera_world=np.eye(4)[None])
    assert background_camera(seen, posed, np.arange(1), 30.0) == (posed, "")


def test_lines_are_kept_in_files_of_detections(tmp_path: Path):
    seen = detections(straight_segments(room(20, 5)))
    np.savez(tmp_path / "seen.npz", **detection_arrays(seen))
    read = read_detection_arrays(tmp_path / "seen.npz")
    assert np.array_equal(read.lines, seen.lines)
    np.savez(tmp_path / "bad.npz", **{**detection_arrays(seen), "lines": np.zeros((3, 4))})
    with pytest.raises(FormatError, match="expected lines"):
        read_detection_arrays(tmp_path / "bad.npz")
