"""Several people in files of 3D keypoints: each is followed, and one is taken."""

import json
from pathlib import Path

import numpy as np
import pytest

from recon.core.errors import FormatError
from recon.keypoints3d.reader import read_points_3d

FRAMES = 12


def landmarks(points: np.ndarray) -> list[dict[str, float]]:
    return [dict(zip("xyz", map(float, point), strict=True)) for point in points]


def people(seed: int = 0) -> np.ndarray:
    """Two people who move, about their hips: (people, frames, 33, 3), metres."""
    random = np.random.default_rng(seed)
    rest = random.uniform(-0.8, 0.8, (2, 1, 33, 3))
    sway = (
        0.1
        * np.sin(np.arange(FRAMES) / 3)[None, :, None, None]
        * random.normal(size=(2, 1, 33, 3))
    )
    return rest + sway


def written(path: Path, seen: np.ndarray, *, image: np.ndarray | None = None) -> Path:
    """A file whose people change places in every third frame; the second is away at first."""
    entries = []
    for t in range(FRAMES):
        order = [0] if t < 4 else ([1, 0] if t % 3 else [0, 1])
        entry = {"frame": t, "pose_world_landmarks": [landmarks(seen[k, t]) for k in order]}
        if image is not None:
            entry["pose_landmarks"] = [landmarks(image[k, t]) for k in order]
        entries.append(entry)
    path.write_text(json.dumps(entries))
    return path


def test_people_of_world_landmarks_are_followed(tmp_path):
    """The first of each frame was taken, whoever it was."""
    seen = people()
    path = written(tmp_path / "two.json", seen)
    found = read_points_3d(path)
    assert np.allclose(found.positions, seen[0])
    assert any("person 0 in 12, person 1 in 8" in one for one in found.decisions)
    other = read_points_3d(path, person=1)
    assert np.isnan(other.positions[:4]).all()
    assert np.allclose(other.positions[4:], seen[1, 4:])


def test_people_who_move_alike_are_told_apart_by_their_place_in_the_image(tmp_path):
    """About the hips they are the same; their order in the file says nothing."""
    seen = people()
    seen[1] = seen[0]
    image = seen * 0.2 + np.array([0.3, 0.5, 0.0])
    image[1, ..., 0] += 0.4
    marked = seen.copy()
    marked[1] += 1e-3  # who it is shows in what is read
    path = written(tmp_path / "twins.json", marked, image=image)
    assert np.allclose(read_points_3d(path, person=0).positions, marked[0])
    assert np.allclose(read_points_3d(path, person=1).positions[4:], marked[1, 4:])


def test_a_person_who_is_not_there_is_refused(tmp_path):
    path = written(tmp_path / "two.json", people())
    with pytest.raises(FormatError, match="there is no person 2; of 12 frames, person 0 in 12"):
        read_points_3d(path, person=2)


def test_bodies_of_azure_kinect_are_chosen_by_number(tmp_path):
    seen = people()
    frames = [
        {
            "timestamp_usec": 33333 * t,
            "bodies": [
                {"body_id": 7 - k, "joint_positions": (1000 * seen[k, t, :32]).tolist()}
                for k in range(2 if t < 9 else 1)
            ],
        }
        for t in range(FRAMES)
    ]
    path = tmp_path / "azure.json"
    path.write_text(json.dumps({"frames": frames}))
    assert np.allclose(read_points_3d(path).positions, 1000 * seen[0, :, :32])
    assert np.allclose(read_points_3d(path, person=1).positions[:9], 1000 * seen[1, :9, :32])


def test_a_person_whose_number_changes_is_one_person(tmp_path):
    """The second half counted as another person and was left out."""
    seen = people()
    frames = [
        {"bodies": [
            {"body_id": 3 if t < 6 else 8, "joint_positions": seen[0, t, :32].tolist()},
            {"body_id": 5, "joint_positions": seen[1, t, :32].tolist()},
        ][: 1 if t > 9 else 2]}
        for t in range(FRAMES) if t != 7
    ]  # fmt: skip
    path = tmp_path / "azure.json"
    path.write_text(json.dumps({"frames": frames}))
    found = read_points_3d(path)
    assert np.allclose(found.positions, np.delete(seen[0, :, :32], 7, axis=0))
    assert any("3 numbers of people are those of 2" in one for one in found.decisions)
    assert np.allclose(read_points_3d(path, person=1).positions[:6], seen[1, :6, :32])


def test_frame_numbers_that_step_by_two_are_consecutive(tmp_path):
    """Every other frame was unseen, and time ran half as fast, without a word."""
    seen = people()
    entries = [
        {"frame": 2 * t, "pose_world_landmarks": [landmarks(seen[0, t])]}
        for t in range(FRAMES) if t != 4
    ]  # fmt: skip
    path = tmp_path / "stepped.json"
    path.write_text(json.dumps(entries))
    found = read_points_3d(path)
    shown = np.isfinite(found.positions).all((1, 2))
    assert np.flatnonzero(~shown).tolist() == [4]
    assert len(shown) == FRAMES
    assert any("step by 2" in one for one in found.decisions)
