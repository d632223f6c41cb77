"""Cameras of 2D keypoints in results and their files: lenses, poses, clocks and moved ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from recon.core.camera import Camera
from recon.core.motion import FilmingCamera, MotionFile
from recon.formats.motions import load_motion, save_motion
from recon.formats.observations import KeypointsFile, save_observation
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, walk

LENS = torch.tensor([-0.2, 0.05, 0.001, 0.002, 0.01])


def seen(frames: int, camera: Camera, first: int = 0) -> KeypointsFile:
    return keypoints2d(
        walk(frames, first), bundled(), camera, Corruption(noise=1.0), 0, "openpose25"
    )


FILMED = cameras(walk(), 1)[0].replace(distortion=LENS)


@pytest.fixture(scope="module")
def back(tmp_path_factory: pytest.TempPathFactory) -> MotionFile:
    """A part of what a camera of unknown pose saw, fitted, written and read."""
    folder, file = tmp_path_factory.mktemp("filmed"), seen(24, FILMED)
    lost = replace(file, camera=replace(file.camera, T_camera_world=None), start_time=2.0)
    save_observation(folder / "left.npz", lost)
    recon.fit(folder / "left.npz", "pose", between=(2.2, 2.7)).save(folder / "motion.npz")
    return load_motion(folder / "motion.npz")


def test_lens_and_clock_of_a_camera_are_kept(back: MotionFile) -> None:
    (kept,) = back.cameras
    assert kept.name == "left"
    assert kept.start_time == 2.0  # of the first picture, not of the part that was cut out
    assert kept.camera.image_size == FILMED.image_size
    assert kept.camera.distortion is not None
    assert torch.equal(kept.camera.distortion[:5], LENS)


@pytest.mark.numerics
def test_camera_that_was_found_draws_the_result_on_its_images(back: MotionFile) -> None:
    (kept,) = back.cameras
    assert back.T_world_camera is not None
    assert torch.allclose(kept.camera.T_world_camera, back.T_world_camera, atol=1e-6)
    assert back.joints is not None
    later = walk(back.motion.frames, 6)
    truth = FILMED.project(bundled().pose(later).joints).pixels
    drawn = kept.camera.project(back.joints).pixels
    assert float((drawn - truth).norm(dim=-1).median()) < 4.0  # pixels


@pytest.mark.numerics
def test_late_clock_of_one_camera_is_kept() -> None:
    every = cameras(walk(60), 3)
    files = [seen(60, one) for one in every[:2]] + [
        replace(seen(60, every[2], first=3), start_time=0.0)
    ]
    found = recon.fit([keypoints_of(one, bundled()) for one in files], "pose")
    assert "views out of step" in {one.code for one in found.repairs}
    early = [one.start_time for one in found.file.cameras]
    assert early[:2] == [0.0, 0.0]
    # its first picture shows what the others see three frames later
    assert early[2] == pytest.approx(3 / 30, abs=0.01)


def test_moving_and_fixed_cameras_are_read_back(tmp_path: Path) -> None:
    one, two = cameras(walk(), 2)
    poses = torch.stack([one.T_camera_world, two.T_camera_world]).repeat(12, 1, 1)
    moving = one.replace(T_camera_world=poses, distortion=LENS)
    fixed = two.replace(T_camera_world=two.T_camera_world[None])
    given = (FilmingCamera("a", moving, 0.25), FilmingCamera("b", fixed))
    save_motion(tmp_path / "m.npz", MotionFile(walk(), cameras=given))
    back = load_motion(tmp_path / "m.npz").cameras
    assert [(one.name, one.start_time) for one in back] == [("a", 0.25), ("b", 0.0)]
    assert torch.equal(back[0].camera.T_camera_world, poses)
    assert torch.equal(back[1].camera.T_camera_world, two.T_camera_world.expand(24, 4, 4))
    assert back[1].camera.distortion is None
    with np.load(tmp_path / "m.npz") as file:
        arrays = dict(file)
    for key, value, said in (
        ("camera_matrix", arrays["camera_matrix"][:1], "expected 2 cameras in all arrays"),
        ("camera_pose", arrays["camera_pose"][:, :5], "camera_pose of shape"),
        ("camera_distortion", None, "lacks camera_distortion"),
    ):
        changed = {name: one for name, one in arrays.items() if name != key}
        np.savez(tmp_path / "bad.npz", **changed, **({} if value is None else {key: value}))
        with pytest.raises(ValueError, match=said):
            load_motion(tmp_path / "bad.npz")
