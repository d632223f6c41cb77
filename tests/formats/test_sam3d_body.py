"""Results of SAM 3D Body as people save them: lists, folders and stacked arrays."""

import pickle
from typing import Any

import numpy as np
import pytest

from recon.cli.looks import refuse_foreign_files
from recon.core.errors import FormatError
from recon.formats.producers import holds_estimated_bodies
from recon.keypoints3d.reader import holds_points_3d, read_points_3d
from recon.reading.inputs import input_checksums

FRAMES, FOCAL, MIDDLE = 60, 1500.0, (960.0, 540.0)


def result(points: np.ndarray, place: np.ndarray, focal: float = FOCAL) -> dict[str, Any]:
    seen = points + place
    pixels = focal * seen[:, :2] / seen[:, 2:] + MIDDLE
    return {
        "focal_length": np.float32(focal),
        "pred_keypoints_3d": points.astype(np.float32),
        "pred_keypoints_2d": pixels.astype(np.float32),
        "pred_cam_t": place.astype(np.float32),
        "mask": None,
    }


def clip(jitter: float = 0.0) -> tuple[list[list[dict[str, Any]]], np.ndarray]:
    """Two people who cross the image, listed in changing order, and where the first is."""
    random = np.random.default_rng(0)
    body = random.uniform(-0.8, 0.8, (2, 70, 3)) * (0.4, 1.0, 0.3)
    frames, truth = [], []
    for t in range(FRAMES):
        places = np.array([[0.02 * t - 0.6, 0.1, 5 + 0.005 * t], [0.6 - 0.02 * t, 0.2, 7.5]])
        size = 1 + jitter * random.normal()
        people = [result(body[k] * size, places[k] * size) for k in range(2)]
        frames.append(people if t % 3 else people[::-1])
        if t == 10:
            frames[-1] = [people[1]]
        truth.append(body[0] + places[0])
    return frames, np.array(truth)


def first(path) -> np.ndarray:
    """The person who is nearer to the camera."""
    found = [read_points_3d(path, person=k).positions for k in range(2)]
    return min(found, key=lambda one: np.nanmean(one[..., 2]))


def test_all_ways_of_saving_give_the_same_place(tmp_path):
    frames, truth = clip()
    (tmp_path / "list.pkl").write_bytes(pickle.dumps(frames))
    objects = np.empty(FRAMES, dtype=object)
    objects[:] = frames
    np.save(tmp_path / "list.npy", objects, allow_pickle=True)
    (tmp_path / "each").mkdir()
    for t, people in enumerate(frames):
        for k, one in enumerate(people):
            np.savez(tmp_path / "each" / f"film_{t}_{k}.npz", **one)
    keys = ("pred_keypoints_3d", "pred_cam_t", "pred_keypoints_2d", "focal_length")
    empty = {key: np.full_like(frames[0][0][key], np.nan) for key in keys}
    padded = [[*people, empty][:2] for people in frames]
    stacked: dict[str, Any] = {
        key: np.array([[one[key] for one in people] for people in padded]) for key in keys
    }
    np.savez(tmp_path / "all.npz", **stacked)
    for name in ("list.pkl", "list.npy", "each", "all.npz"):
        path = tmp_path / name
        assert holds_points_3d(path)
        assert not holds_estimated_bodies([path])
        refuse_foreign_files([path])
        found = first(path)
        assert np.isnan(found[10]).all()
        assert np.nanmax(np.abs(found - truth)) < 1e-3
        assert "focal length 1500 px, middle of the image (960, 540)" in str(
            read_points_3d(path, person=0).decisions
        )


def test_places_that_are_added_already_and_sizes_that_change(tmp_path):
    frames, truth = clip(jitter=0.02)
    for people in frames:
        for one in people:
            one["pred_keypoints_3d"] += one["pred_cam_t"]
    path = tmp_path / "added.pkl"
    path.write_bytes(pickle.dumps(frames))
    found = first(path)
    ratio = found / truth
    assert np.nanstd(ratio[..., 2]) < 2e-3
    assert "pred_cam_t is in pred_keypoints_3d already" in read_points_3d(path).decisions


def test_people_whose_depth_jumps_are_followed(tmp_path):
    """Depths of single images jump by more than people are told apart by in space."""
    frames, _ = clip()
    random = np.random.default_rng(1)
    for people in frames:
        for one in people:
            place = one["pred_cam_t"] * (1 + 0.05 * random.normal())
            one.update(result(one["pred_keypoints_3d"], place))
    path = tmp_path / "jumps.pkl"
    path.write_bytes(pickle.dumps(frames))
    found = first(path)
    assert np.isfinite(found).all((1, 2)).sum() == FRAMES - 1
    assert np.abs(np.diff(found[20:40, 9, 2])).max() < 0.2


def test_jitter_along_the_ray_goes_from_the_ends_too(tmp_path):
    """The last frame kept its error, and the body rushed there by 3 m/s.

    Too narrow a filter was taken as well where third differences told less noise by chance.
    """
    rushed = []
    for seed in range(12):
        random = np.random.default_rng(seed)
        body = random.uniform(-0.8, 0.8, (70, 3)) * (0.4, 1.0, 0.3)
        ways = np.array([(0, 0, 4 + 0.01 * t) for t in range(FRAMES)])
        near = [[result(body, way * np.exp(0.03 * random.normal()))] for way in ways]
        path = tmp_path / f"{seed}.pkl"
        path.write_bytes(pickle.dumps(near))
        depth = read_points_3d(path).positions[:, 9, 2]
        rushed.append(30 * np.abs(np.diff(depth) - 0.01).max())
    assert np.median(rushed) < 0.4
    assert max(rushed) < 1.0


def test_focal_lengths_that_change_become_one(tmp_path):
    _, truth = clip()
    body = truth[0] - (-0.6, 0.1, 5)
    alone = [[result(body, np.array([0, 0, f / 300]), f)] for f in np.linspace(1400, 1600, FRAMES)]
    path = tmp_path / "focal.pkl"
    path.write_bytes(pickle.dumps(alone))
    found = read_points_3d(path)
    assert np.ptp(found.positions[:, 9, 2]) < 1e-3
    assert any("changed between 1400 and 1600 px" in one for one in found.decisions)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("pred_keypoints_2d", np.arange(140.0).reshape(70, 2) % 37, "px from the projection"),
        ("pred_keypoints_3d", np.zeros((69, 3)), "expected pred_keypoints_3d"),
        ("focal_length", np.float32(900), "focal_length is 900 px"),
        ("pred_cam_t", None, "expected the person.s place, pred_cam_t"),
        ("pred_cam_t", np.array([0, 0, -4.0]), "in front of the camera"),
    ],
)
def test_what_cannot_be_is_refused_by_its_key(tmp_path, key, value, message):
    frames, _ = clip()
    frames[3][0][key] = value
    path = tmp_path / "wrong.pkl"
    path.write_bytes(pickle.dumps(frames))
    with pytest.raises(FormatError, match=message):
        read_points_3d(path)


def test_pickles_run_nothing(tmp_path):
    path = tmp_path / "bad.pkl"
    path.write_bytes(pickle.dumps([{"pred_keypoints_3d": print}]))
    with pytest.raises(FormatError, match="refusing to load"):
        read_points_3d(path)


def test_folders_are_inputs_of_refine(tmp_path):
    frames, _ = clip()
    np.savez(tmp_path / "0.npz", **frames[0][0])
    before = input_checksums({"motion": tmp_path})
    np.savez(tmp_path / "1.npz", **frames[1][0])
    assert before != input_checksums({"motion": tmp_path})
