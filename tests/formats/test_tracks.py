"""Tracks of a camera: one path as four trackers write it, and what is no track."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from observations.camera_paths import metres_per_path_unit
from observations.keypoints2d import Keypoints2D
from recon.core.camera import Camera
from recon.fitting.settings import FitSettings
from recon.formats.cameras import CameraPath
from recon.formats.tracks import read_track
from recon.reading.clip import load_clip
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d, orbiting_camera
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, walk
from tests.formats.track_files import (
    UNIT,
    in_units,
    seven,
    write_arkit,
    write_colmap,
    write_droid,
    write_tum,
)
from tests.keypoint_scene import write_openpose

FRAMES = 30


def moving(frames: int = FRAMES) -> Camera:
    """A phone that is carried around the walk by a quarter turn."""
    motion = walk(frames)
    middle = bundled().pose(motion).joints.flatten(0, 1).mean(0)
    return orbiting_camera(cameras(motion, first=0.7)[0], middle, frames, math.radians(90.0))


def poses() -> np.ndarray:
    """T_world_camera, metres, z up."""
    return moving().T_world_camera.double().numpy()


def files(folder: Path) -> dict[str, Path]:
    T = poses()
    return {
        "COLMAP": write_colmap(folder / "sparse", T),
        "TUM": write_tum(folder / "traj", T),
        "DROID-SLAM": write_droid(folder / "traj", T),
        "ARKit": write_arkit(folder / "arkit", T),
    }


def test_every_tracker_tells_the_same_path(tmp_path) -> None:
    """Conventions as their documents say; only COLMAP's poses are of the world in the camera."""
    for producer, path in files(tmp_path).items():
        found = read_track(path)
        assert found.producer == producer
        assert found.metric == found.level == (producer == "ARKit")
        T, _ = found.poses_at_frames(1, FRAMES, 30.0)
        true = poses() if found.metric else in_units(poses())
        np.testing.assert_allclose(T, true, atol=2e-6)
        if producer in ("COLMAP", "ARKit"):
            assert found.camera is not None
            np.testing.assert_allclose(
                np.array(found.camera.matrix), [[1500, 0, 960], [0, 1500, 540], [0, 0, 1]]
            )
    rowwise = read_track(write_arkit(tmp_path / "rows", poses(), by_columns=False))
    np.testing.assert_allclose(rowwise.T_world_camera, poses(), atol=1e-6)


def test_keyframes_are_joined_by_straight_ways(tmp_path) -> None:
    T = in_units(poses())
    np.savez(tmp_path / "key.npz", poses=seven(T)[::3], tstamps=np.arange(FRAMES)[::3])
    found, _ = read_track(tmp_path / "key.npz").poses_at_frames(0, FRAMES, 30.0)
    np.testing.assert_allclose(found[::3], T[::3], atol=1e-6)
    assert np.abs(found - T)[: FRAMES - 2].max() < 0.02
    with pytest.raises(ValueError, match="poses of the same film"):
        read_track(tmp_path / "key.npz").poses_at_frames(500, FRAMES, 30.0)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("traj.txt", "0 1 2 3 0 0 0\n", "timestamp tx ty tz qx qy qz qw"),
        ("traj.txt", "0 1 2 3 9 9 9 9\n1 1 2 3 9 9 9 9\n", "quaternions of length 1"),
        ("images.txt", "1 1 0 0 0 0 0 0 1\n\n", "QW QX QY QZ"),
        ("a.json", '[{"pose": 1}]', "frames of ARKit"),
        ("a.json", '[{"transform": [1, 2]}]', "expected 16 numbers"),
        ("a.fbx", "x", "expected the track of a camera"),
    ],
)
def test_what_is_no_track_is_refused(tmp_path, name, text, said) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=said):
        read_track(tmp_path / name)


def test_arrays_of_other_shapes_are_refused(tmp_path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"an array \(frames, 7\)"):
        read_track(tmp_path / "a.npy")


def test_standing_feet_tell_the_unit() -> None:
    """Feet in the frame of the camera that moves, and its path in another unit."""
    feet = bundled().pose(walk(FRAMES)).joints[:, [10, 11]]
    seen = moving().to_camera(feet).double().numpy()
    assert metres_per_path_unit(in_units(poses()), seen, 30.0) == pytest.approx(1 / UNIT, rel=0.05)
    still = np.tile(np.eye(4), (FRAMES, 1, 1))
    assert metres_per_path_unit(still, seen, 30.0) == 1.0


def test_a_film_with_a_track_is_read(tmp_path) -> None:
    """Path and unit are those of the camera that filmed it; up is the level first camera's."""
    motion, camera = walk(FRAMES), moving()
    file = keypoints2d(motion, bundled(), camera, Corruption(noise=1.0), 0)
    people = np.concatenate((file.pixels, file.confidence[..., None]), -1)
    folder = write_openpose(tmp_path / "film", [[person] for person in people])
    track = files(tmp_path)["COLMAP"]
    settings = FitSettings(frame_rate=30.0, layout="openpose25", camera_track=track)
    clip = load_clip([folder], settings, bundled())
    (seen,) = clip.observations
    assert any("COLMAP" in note and "standing feet" in note for note in clip.notes)
    assert not seen.ground_known
    assert isinstance(seen, Keypoints2D)
    assert seen.camera.T_camera_world.shape == (1, FRAMES, 4, 4)
    eyes = seen.camera.T_world_camera[0, :, :3, 3]
    true = camera.T_world_camera[:, :3, 3]
    length = (eyes[-1] - eyes[0]).norm() / (true[-1] - true[0]).norm()
    assert 0.6 < float(length) < 1.6  # a first guess, which the fit corrects
    with pytest.raises(ValueError, match="one view"):
        load_clip([folder, folder], settings, bundled())


def test_a_path_in_metres_is_left_as_it_is() -> None:
    camera = moving()
    file = keypoints2d(walk(FRAMES), bundled(), camera, Corruption(noise=1.0), 0)
    path = CameraPath(poses(), metric=True, level=True)
    arrays = replace(file.camera, T_camera_world=None, path=path)
    seen = keypoints_of(replace(file, camera=arrays), bundled())
    assert seen.level
    assert seen.unit_known
    found = seen.camera.T_world_camera[0, :, :3, 3]
    true = camera.T_world_camera[:, :3, 3]
    torch.testing.assert_close(found - found[:1], true - true[:1], atol=1e-5, rtol=0)
