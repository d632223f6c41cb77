"""Files of one clip, end to end: the camera's pose in the result, masks, what does not fit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from observations.common_clock import on_common_clock
from observations.depth import PointCloud
from observations.first_guess import with_first_guess
from observations.joints3d import Joints3D
from observations.keypoints2d import Keypoints2D
from observations.surfels import Surfels
from recon.core.rotations import transform
from recon.fitting.records import Clip, clip_between
from recon.fitting.settings import FitSettings
from recon.formats.motions import load_motion
from recon.formats.observations import save_observation
from recon.method.sensor import frame_is_level
from recon.reading.clip import load_clip
from recon.reading.images import keypoints_of
from recon.simulation.images import camera_arrays, keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import NOISE, bundled, cameras, walk
from tests.keypoint_scene import write_openpose, write_toml
from tests.verbs import fit_files

POSE = FitSettings(prior="pose")


def observed(folder: Path, posed: bool, name: str = "view") -> Path:
    camera = cameras(walk(16))[0]
    file = keypoints2d(walk(16), bundled(), camera, Corruption(noise=NOISE), 0)
    if not posed:
        file = replace(file, camera=replace(file.camera, T_camera_world=None))
    save_observation(folder / f"{name}.npz", file)
    return folder / f"{name}.npz"


def test_a_camera_of_unknown_pose_is_in_the_result(tmp_path):
    """The motion in both frames: joints in the camera follow from either."""
    report = fit_files([observed(tmp_path, posed=False)], tmp_path / "out.npz", POSE)
    assert not report["ground_known"]
    assert report["warnings"] == []
    result = load_motion(tmp_path / "out.npz")
    assert result.T_world_camera is not None
    assert result.in_camera is not None
    assert result.joints is not None
    T = torch.linalg.inv(result.T_world_camera[0])
    pelvis = bundled().rest_joints(result.motion.shape)[0]
    seen = result.motion.carried(T, pelvis)
    torch.testing.assert_close(result.in_camera[:, :3], seen.translation, atol=1e-4, rtol=0)
    in_camera = transform(T, result.joints)
    torch.testing.assert_close(bundled().pose(seen).joints, in_camera, atol=1e-4, rtol=0)  # metres
    torch.testing.assert_close(
        result.in_camera[:, :3] + pelvis, in_camera[:, 0], atol=1e-4, rtol=0
    )
    truth = cameras(walk(16))[0].to_camera(bundled().pose(walk(16)).joints)
    about = (in_camera - in_camera[:, :1]) - (truth - truth[:, :1])
    assert about.norm(dim=-1).mean() < 0.09
    assert abs(float(result.joints[..., 2].amin(-1).median())) < 0.1  # on the ground


def test_a_camera_of_known_pose_leaves_the_world_as_it_is(tmp_path):
    report = fit_files([observed(tmp_path, posed=True)], tmp_path / "out.npz", POSE)
    assert report["ground_known"]
    result = load_motion(tmp_path / "out.npz")
    away = bundled().pose(result.motion).joints - bundled().pose(walk(16)).joints
    assert away.norm(dim=-1).mean() < 0.09
    assert report["residuals"][0]["unit"] == "pixels"
    assert report["residuals"][0]["median"] < 2 * NOISE


def test_two_cameras_of_unknown_pose_are_refused(tmp_path):
    files = [observed(tmp_path, posed=False, name=name) for name in "ab"]
    with pytest.raises(ValueError, match="relative positions are unknown"):
        load_clip(files, POSE, bundled())


def test_points_outside_a_mask_are_not_believed(tmp_path):
    """A detector that guesses the legs behind a table; the silhouette ends above it."""
    camera = cameras(walk(16))[0]
    file = keypoints2d(walk(16), bundled(), camera, Corruption(noise=NOISE), 0)
    hip = int(file.pixels[:, 8, 1].max()) + 30
    masks = np.zeros((16, 1080, 1920), dtype=bool)
    masks[:, :hip] = True
    np.savez_compressed(tmp_path / "masks.npz", mask=masks)
    people = np.concatenate((file.pixels, file.confidence[..., None]), -1)
    folder = write_openpose(tmp_path / "cam0", [[person] for person in people])
    arrays = replace(camera_arrays(camera), distortion=np.zeros(4))
    calibration = write_toml(tmp_path / "Calib.toml", {"cam0": arrays})
    settings = FitSettings(
        prior="pose", camera=calibration, frame_rate=30.0, layout="openpose25",
        masks=tmp_path / "masks.npz",
    )  # fmt: skip
    (seen,) = load_clip([folder], settings, bundled()).observations
    assert isinstance(seen, Keypoints2D)
    below = torch.from_numpy(file.pixels[..., 1] > hip + 20)
    assert below.any()
    assert (seen.confidence[0][below] == 0).all()
    assert (seen.confidence[0, :, :9] > 0).any(0).all()
    whole = replace(settings, masks=None)
    (unmasked,) = load_clip([folder], whole, bundled()).observations
    assert isinstance(unmasked, Keypoints2D)
    assert (unmasked.confidence > 0).all()
    assert torch.equal(seen.pixels[0][below], torch.zeros_like(seen.pixels[0][below]))


def test_a_stretch_ends_where_the_observations_do():
    """`--between 0 10` of a trial from 1.3 to 3.3 s gave ten seconds, most of them invented."""
    places, visible = torch.rand(1, 10, 2, 3), torch.ones(1, 10, 2, dtype=torch.bool)
    seen = Joints3D(places, visible, (4, 5), 10.0, start_time=2.0)
    clip = Clip((seen,), ("joints",), (), None)
    (kept,) = clip_between(clip, 0.0, 10.0).observations
    assert kept.start_time == 2.0
    assert kept.shown.shape == (1, 10, 2)
    (part,) = clip_between(clip, 0.0, 2.35).observations
    assert part.shown.shape == (1, 4, 2)
    with pytest.raises(ValueError, match="nothing was seen between 5 and 9 s"):
        clip_between(clip, 5.0, 9.0)
    with pytest.raises(ValueError, match="nothing was seen between 0 and 1 s"):
        clip_between(clip, 0.0, 1.0)  # it gave the first frame


def test_a_motion_lasts_as_long_as_all_sensors_together():
    """It lasted as long as the first sensor with names: half of all other data was dropped."""
    joints = bundled().pose(walk(31)).joints[None]
    shown = torch.ones(1, 31, 22, dtype=torch.bool)
    early = Joints3D(joints, shown, tuple(range(22)), 30.0)
    late = early.derived(start_time=0.5)
    _, guess = with_first_guess((late, early), bundled(), None, None)
    assert guess.motion.start_time == 0.0
    assert guess.motion.frames == 46
    _, again = with_first_guess((late, early), bundled(), guess.motion, None)
    assert again.motion.frames == 46
    with pytest.raises(ValueError, match="on one clock"):
        with_first_guess((late.derived(start_time=1.7e9), early), bundled(), None, None)


def test_scans_without_a_floor_keep_their_vertical():
    """They were tilted by 5 degrees, as the posture had to tell which way is up."""
    points, present = torch.rand(1, 2, 50, 3), torch.ones(1, 2, 50, dtype=torch.bool)
    scans = PointCloud(points, present, Surfels.of(bundled(), 100), 10.0, ground_known=False)
    assert frame_is_level((scans,))


def test_views_of_other_lengths_are_compared_with_each_other():
    """A wrong clock was not found if one film was longer, and 8 cm of error were left."""
    files = [keypoints2d(walk(16), bundled(), one, Corruption(noise=NOISE), k)
             for k, one in enumerate(cameras(walk(16), 2))]  # fmt: skip
    first, second = (keypoints_of(file, bundled()) for file in files)
    cut = second.map_frames(lambda x: x[:, 2:-3])
    short = second.derived(start_time=second.start_time + 2 / second.fps, **cut)
    whole, padded = on_common_clock((first, short))
    assert whole is first
    assert padded.start_time == first.start_time
    torch.testing.assert_close(padded.pixels[:, 2:-3], short.pixels)
    assert float(padded.confidence[:, :2].max()) == 0.0
    between = short.derived(start_time=short.start_time + 0.5 / short.fps)
    assert on_common_clock((first, between))[1] is between
