"""Keypoint files as observations: distortion taken out once, poses known or not."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from recon.core.camera import Ground
from recon.fitting.ground import LEVEL_CAMERA
from recon.reading.images import keypoints_of, undistorted_camera, undistorted_keypoints
from recon.simulation.images import camera_arrays, keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, walk

LENS = torch.tensor([-0.12, 0.05, 0.001, -0.002, 0.01])


def filmed(distortion=None, **corruption):
    truth = walk(6)
    camera = cameras(truth)[0].replace(distortion=distortion)
    return truth, camera, keypoints2d(truth, bundled(), camera, Corruption(**corruption), 0)


def test_a_lens_is_taken_out_once():
    truth, _, file = filmed(LENS)
    _, _, perfect = filmed()
    seen = file.confidence > 0
    assert np.abs(file.pixels - perfect.pixels)[seen].max() > 2  # pixels
    # OpenCV's own iteration ends at a few hundredths of a pixel
    np.testing.assert_allclose(undistorted_keypoints(file)[seen], perfect.pixels[seen], atol=0.1)
    view = keypoints_of(file, bundled())
    assert view.camera.distortion is None
    points = view.points.of(bundled().pose(truth))[None]
    away = (view.camera.project(points).pixels - view.pixels).norm(dim=-1)
    assert away[view.confidence > 0].max() < 0.1


def test_a_file_becomes_one_clip_with_its_clock_and_noise_free_zeros():
    truth, _, file = filmed(missing_points=0.3)
    view = keypoints_of(replace(file, start_time=1.5), bundled(), sigma=50.0)
    assert view.pixels.shape == (1, 6, 25, 2)
    assert view.sigma == 50.0
    assert (view.fps, view.start_time, view.ground_known) == (truth.fps, 1.5, True)
    assert (view.pixels[view.confidence == 0] == 0).all()
    assert 0.5 < float((view.confidence > 0).float().mean()) < 0.9


def test_a_camera_without_pose_sees_a_level_world():
    _, _, file = filmed()
    lost = replace(file, camera=replace(file.camera, T_camera_world=None))
    view = keypoints_of(lost, bundled())
    assert not view.ground_known
    T = view.camera.T_camera_world[0, 0]
    ground = Ground.seen_from(T)
    torch.testing.assert_close(ground.coefficients, torch.tensor(LEVEL_CAMERA))
    assert float(torch.linalg.det(T[:3, :3])) == pytest.approx(1.0, abs=1e-6)
    eye = view.camera.T_world_camera[0, 0, :3, 3]
    torch.testing.assert_close(eye, torch.tensor([0.0, 0.0, 1.2]), atol=1e-6, rtol=0)
    elsewhere = np.eye(4)
    elsewhere[:3, 3] = 1.0, 2.0, 3.0
    told = keypoints_of(lost, bundled(), elsewhere)
    torch.testing.assert_close(
        told.camera.T_world_camera[0, 0], torch.from_numpy(elsewhere).float()
    )


def test_a_known_pose_is_kept_whatever_the_recording_is():
    _, camera, file = filmed()
    view = keypoints_of(file, bundled(), np.eye(4))
    torch.testing.assert_close(view.camera.T_camera_world[0, 0], camera.T_camera_world)


def test_one_pose_per_frame_stays_one_per_frame():
    _, camera, _ = filmed()
    moving = camera.replace(T_camera_world=camera.T_camera_world.expand(6, 4, 4))
    assert undistorted_camera(camera_arrays(moving)).T_camera_world.shape == (6, 4, 4)
    assert undistorted_camera(camera_arrays(camera)).T_camera_world.shape == (1, 4, 4)


def test_another_number_of_points_is_refused():
    _, _, file = filmed()
    with pytest.raises(ValueError, match="17 keypoints, got 25"):
        keypoints_of(replace(file, layout="coco17"), bundled())
    with pytest.raises(ValueError, match="no layout"):
        keypoints_of(replace(file, layout="kinect"), bundled())


def test_points_that_a_body_lacks_are_not_seen(toy_body):
    _, _, file = filmed()
    view = keypoints_of(file, toy_body)
    assert (view.confidence[..., ~view.points.known] == 0).all()
    assert (view.confidence[..., view.points.known] > 0).any()
