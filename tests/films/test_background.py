"""What the background of a film tells of its camera: still, turning, or carried."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon.core.errors import FormatError
from recon.detections.records import Background, Detections
from recon.detections.tables import detection_arrays, read_detection_arrays
from recon.films.background import FollowedPoints, points_if_camera_moves
from recon.films.carrying import find_path
from recon.films.turning import find_turning
from recon.formats.cameras import guessed_camera
from recon.reading.stated import background_camera, cut_to_longest_shot

WIDTH, HEIGHT, FOCAL, FRAMES = 480, 360, 450.0, 24
MIDDLE = np.array([WIDTH, HEIGHT]) / 2
MATRIX = np.array([[FOCAL, 0, MIDDLE[0]], [0, FOCAL, MIDDLE[1]], [0, 0, 1.0]])


@cache
def panorama() -> np.ndarray:
    """Rectangles of any colour all around, 8 pixels a degree."""
    chance, image = np.random.default_rng(0), np.full((1440, 2880, 3), 90, np.uint8)
    for _ in range(1200):
        x, y = chance.integers(0, 2880), chance.integers(0, 1440)
        w, h = chance.integers(20, 90, 2)
        colour = tuple(map(int, chance.integers(0, 255, 3)))
        cv2.rectangle(image, (x, y), (x + w, y + h), colour, -1)
    return image


def turned(degrees: float) -> np.ndarray:
    """Rotations of a camera that pans, and nods a little, from its frame to the first one."""
    share = np.linspace(0, 1, FRAMES)
    angles = np.column_stack((degrees * share, 0.1 * degrees * np.sin(9 * share)))
    found = Rotation.from_euler("YX", angles, degrees=True)
    return (found[0].inv() * found).as_matrix()


def film(rotations: np.ndarray, *, flicker: float = 0.0, wall: bool = False) -> Background:
    """Points that are followed in noisy pictures before which somebody in stripes walks."""
    chance, followed = np.random.default_rng(1), FollowedPoints()
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack((u, v, np.ones_like(u)), -1) @ np.linalg.inv(MATRIX).T
    for frame, R in enumerate(rotations):
        x, y, z = np.moveaxis(rays @ R.T, -1, 0)
        across, up = np.degrees(np.arctan2(x, z)), np.degrees(np.arctan2(y, np.hypot(x, z)))
        there = [
            (8 * (angle + 180 - off)).astype(np.float32) for angle, off in ((across, 0), (up, 90))
        ]
        image = cv2.remap(panorama(), *there, cv2.INTER_LINEAR).astype(float)
        image = np.full_like(image, 120.0) if wall else image
        low, high = box(frame).round().astype(int)
        image[low[1] : high[1], low[0] : high[0]] = (
            200 * (np.arange(high[1] - low[1]) // 9 % 2)[:, None, None]
        )
        image = image * (1 + flicker * np.sin(frame)) + chance.normal(0, 3, image.shape)
        followed.follow(np.clip(image, 0, 255).astype(np.uint8), frame, 0)
    pixels = np.concatenate(followed.pixels)
    return Background(np.concatenate(followed.frames), np.concatenate(followed.numbers), pixels)


def box(frame: int) -> np.ndarray:
    """Corners of the person who walks."""
    return np.array([[60.0 + 5 * frame, 80.0], [150.0 + 5 * frame, 340.0]])


def people(background: Background | None = None) -> Detections:
    """Somebody in every frame, whose keypoints lie on their outline."""
    frames = np.arange(FRAMES)
    ends = np.stack([box(frame) for frame in frames])
    along = np.linspace(0, 1, 33)[:, None]
    return Detections(
        name="film.mp4", layout="mediapipe33", frame_numbers=frames, frame=frames,
        pixels=ends[:, :1] + along * (ends[:, 1:] - ends[:, :1]), frame_rate=30.0,
        confidence=np.ones((FRAMES, 33)), identity=np.zeros(FRAMES, int),
        image_size=(WIDTH, HEIGHT), background=background,
    )  # fmt: skip


@cache
def panned() -> Background:
    behind, said = points_if_camera_moves(film(turned(30.0), flicker=0.02), people())
    assert behind is not None
    assert said == ""
    return behind


def test_turns_and_focal_length_of_a_pan_are_found():
    behind, true = panned(), turned(30.0)
    kept = behind.frame != 11  # a frame that the camera dropped
    found = find_turning(
        behind.frame[kept], behind.point[kept], behind.pixels[kept] - MIDDLE, 1.15 * FOCAL,
        focal_known=False,
    )  # fmt: skip
    assert found is not None
    assert found.focal_told
    assert found.focal == pytest.approx(FOCAL, rel=0.02)
    off = Rotation.from_matrix(true.swapaxes(1, 2) @ found.poses_at(np.arange(FRAMES))[:, :3, :3])
    assert np.degrees(off.magnitude().max()) < 0.5


def test_known_focal_length_is_kept():
    behind = panned()
    found = find_turning(
        behind.frame, behind.point, behind.pixels - MIDDLE, FOCAL, focal_known=True
    )
    assert found is not None
    assert not found.focal_told
    assert found.focal == FOCAL


@pytest.mark.parametrize("flicker", [0.0, 0.2])
def test_still_camera_is_not_moved_by_people_noise_or_flicker(flicker: float):
    seen = film(turned(0.0), flicker=flicker)
    assert points_if_camera_moves(seen, people()) == (None, "")


def test_too_few_points_of_the_background_are_said():
    behind, said = points_if_camera_moves(film(turned(30.0), wall=True), people())
    assert behind is None
    assert "too few" in said


def test_nobody_is_followed_from_one_shot_into_another():
    followed = FollowedPoints()
    image = panorama()[500:860, 900:1380]
    for shot in range(2):
        followed.follow(image, shot, shot)
    assert not set(followed.numbers[0]) & set(followed.numbers[1])


def test_camera_of_a_film_turns_as_its_background_tells():
    camera, said = background_camera(
        people(panned()), guessed_camera((WIDTH, HEIGHT)), np.arange(FRAMES), 30.0
    )
    assert "turns by up to" in said
    assert camera.focal_known
    assert camera.path is not None
    assert not camera.path.level
    R = camera.path.T_world_camera[:, :3, :3]
    off = Rotation.from_matrix((R[0].T @ R).swapaxes(1, 2) @ turned(30.0))
    assert np.degrees(off.magnitude().max()) < 0.5


def carried(step: float, noise: float = 0.2) -> tuple[Background, np.ndarray]:
    """Points in a room before a camera that walks past, sways and turns; its places."""
    chance, time = np.random.default_rng(0), np.arange(FRAMES)
    points = chance.uniform((-3, -1.5, 2), (6, 1.5, 9), (90, 3))
    places = step * np.column_stack((time, 0.4 * np.sin(0.3 * time), 0.3 * time))
    frame, point = (one.ravel() for one in np.mgrid[:FRAMES, :90])
    there = np.einsum("nji,nj->ni", turned(10.0)[frame], points[point] - places[frame])
    pixels = FOCAL * there[:, :2] / there[:, 2:] + MIDDLE
    pixels += noise * chance.standard_normal(pixels.shape)
    inside = ((pixels > 0) & (pixels < 2 * MIDDLE)).all(1)
    return Background(frame[inside], point[inside], pixels[inside]), places


def test_path_of_a_carried_camera_is_found_up_to_its_unit():
    behind, places = carried(0.13)
    people_there = people(behind)
    assert points_if_camera_moves(behind, people())[0] is not None
    guess = guessed_camera((WIDTH, HEIGHT))
    camera, said = background_camera(people_there, guess, np.arange(FRAMES), 30.0)
    assert "is carried" in said
    assert camera.path is not None
    assert not camera.path.metric
    assert camera.camera_matrix[0, 0] == pytest.approx(FOCAL, rel=0.06)
    T = np.linalg.inv(camera.path.T_world_camera[0]) @ camera.path.T_world_camera
    found, unit = T[:, :3, 3], np.linalg.norm(places[-1])
    found = found * unit / np.linalg.norm(found[-1])
    assert np.abs(found - places).max() < 0.05 * unit
    off = Rotation.from_matrix(T[:, :3, :3].swapaxes(1, 2) @ turned(10.0))
    assert np.degrees(off.magnitude().max()) < 1.5


def test_path_that_cannot_be_told_is_said_to_be_needed():
    behind, _ = carried(0.004, noise=0.5)
    guess = guessed_camera((WIDTH, HEIGHT))
    pixels = behind.pixels - MIDDLE
    small = find_path(behind.frame, behind.point, pixels, FOCAL, focal_known=True, rate=30.0)
    assert isinstance(small, str)
    chance = np.random.default_rng(0)
    torn = replace(behind, pixels=chance.uniform(0, 2 * MIDDLE, behind.pixels.shape))
    same, said = background_camera(people(torn), guess, np.arange(FRAMES), 30.0)
    assert same is guess
    assert "--camera-track" in said


def test_background_of_another_shot_does_not_count():
    found = replace(people(panned()), shots=(16,))
    kept, _, _ = cut_to_longest_shot(found, 30.0, None)
    assert kept.background is not None
    assert kept.background.frame.max() == 15


def test_background_is_kept_in_files_of_detections(tmp_path: Path):
    found, path = people(panned()), tmp_path / "found.npz"
    arrays = detection_arrays(found)
    np.savez(path, **arrays)
    again = read_detection_arrays(path).background
    assert again is not None
    for name in ("frame", "point", "pixels"):
        assert (getattr(again, name) == getattr(found.background, name)).all()
    np.savez(path, **{**arrays, "background_of": arrays["background_of"][:-1]})
    with pytest.raises(FormatError, match="background_of"):
        read_detection_arrays(path)
