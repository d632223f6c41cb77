"""Simulated images: cameras see everybody, noise is what was asked for, boxes hide."""

import numpy as np
import pytest
import torch

from observations.correspondences import BodyPoints
from recon.core.camera import full_hd_camera
from recon.simulation.images import (
    camera_arrays,
    camera_ring,
    crosses_box,
    keypoints2d,
    orbiting_camera,
)
from recon.simulation.points import Corruption
from tests.filmed import bundled, cameras, turned, walk


def film(layout="openpose25", camera=None, seed=0, **corruption):
    truth = walk(60)
    camera = cameras(truth)[0] if camera is None else camera
    file = keypoints2d(truth, bundled(), camera, Corruption(**corruption), seed, layout)
    points = BodyPoints.of_layout(layout, bundled()).of(bundled().pose(truth))
    return file, camera.project(points).pixels.numpy()


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_a_dome_sees_the_whole_body_always(count):
    truth = turned(walk(60), 1.0)
    for camera in camera_ring(truth, bundled(), full_hd_camera(), count, first=0.7):
        file = keypoints2d(truth, bundled(), camera, Corruption(), 0)
        assert (file.confidence > 0).all()
        assert np.ptp(file.pixels[..., 1], axis=1).max() > 1080 / 3  # and large


def test_two_cameras_stand_at_a_right_angle():
    truth = walk(60)
    middle = bundled().pose(truth).joints.flatten(0, 1)
    middle = ((middle.amin(0) + middle.amax(0)) / 2)[:2]
    a, b = (c.T_world_camera[:2, 3] - middle for c in cameras(truth, 2))
    assert abs(float(torch.dot(a, b)) / float(a.norm() * b.norm())) < 1e-4


def test_noise_has_the_size_asked_for_and_confidence_knows_of_it():
    file, true = film(noise=3.0)
    error = file.pixels - true
    assert error.std() == pytest.approx(3.0, rel=0.05)
    far = np.linalg.norm(error, axis=-1)
    assert np.corrcoef(far.ravel(), file.confidence.ravel())[0, 1] < -0.9
    assert ((file.confidence > 0) & (file.confidence <= 1)).all()
    again, _ = film(noise=3.0)
    assert np.array_equal(file.pixels, again.pixels)
    other, _ = film(noise=3.0, seed=1)
    assert not np.array_equal(file.pixels, other.pixels)


def test_what_is_missing_is_zero_with_no_confidence():
    file, _ = film(missing_points=0.3, missing_frames=0.2)
    gone = file.confidence == 0
    assert 0.35 < gone.mean() < 0.55
    assert (file.pixels[gone] == 0).all()
    assert gone.all(1).any()
    assert file.truth_visible is not None
    assert file.truth_visible.all()  # nothing hides the joints from the camera


def test_a_box_hides_what_lies_behind_it_for_its_time():
    truth = walk(60)
    camera = cameras(truth)[0]
    eye = camera.T_world_camera[:3, 3]
    pelvis = bundled().pose(truth).joints[:, 0].mean(0)
    middle = eye + 0.5 * (pelvis - eye)
    low = (*(middle[:2] - 1.0).tolist(), 0.0)
    high = (*(middle[:2] + 1.0).tolist(), 0.9)
    file, _ = film(camera=camera, hide_box=(low, high), during=(0.5, 1.0))
    names = BodyPoints.of_layout("openpose25", bundled()).names
    ankle, nose = names.index("left_ankle"), names.index("nose")
    when = (truth.times >= 0.5) & (truth.times < 1.0)
    assert (file.confidence[when.numpy(), ankle] == 0).all()
    assert (file.confidence[~when.numpy(), ankle] > 0).all()
    assert (file.confidence[:, nose] > 0).all()
    assert file.truth_visible is not None
    assert not file.truth_visible[when.numpy(), 7].any()


def test_outliers_lie_anywhere_in_the_image():
    file, true = film(outliers=0.2)
    far = np.linalg.norm(file.pixels - true, axis=-1) > 50
    assert 0.13 < far.mean() < 0.22
    assert ((file.pixels >= 0) & (file.pixels <= (1920, 1080))).all()


def test_what_leaves_the_image_or_is_behind_is_not_seen():
    truth = walk(60)
    camera = cameras(truth)[0]
    near = bundled().pose(truth).joints[30, 0] + torch.tensor([0.8, 0.0, 0.3])
    close = camera.placed(near, near + torch.tensor([-1.0, 0.0, 0.0]))
    file, true = film(camera=close)
    outside = ((true < 0) | (true >= (1920, 1080))).any(-1)
    assert (file.confidence[outside] == 0).all()
    assert (file.confidence > 0).any()
    assert np.isfinite(file.pixels).all()
    away = camera.placed(near, near + torch.tensor([1.0, 0.0, 0.0]))
    assert (film(camera=away)[0].confidence == 0).all()


def test_an_orbiting_camera_keeps_looking_at_its_target():
    target = torch.tensor([0.2, -0.1, 1.0])
    start = full_hd_camera().placed(torch.tensor([4.0, 0.0, 1.5]), target)
    moving = orbiting_camera(start, target, 30, 0.7)
    assert moving.T_camera_world.shape == (30, 4, 4)
    torch.testing.assert_close(moving.T_camera_world[0], start.T_camera_world)
    pixels = moving.project(target.expand(30, 1, 3)).pixels
    torch.testing.assert_close(pixels, torch.tensor([960.0, 540.0]).expand(30, 1, 2))
    eyes = moving.T_world_camera[:, :2, 3] - target[:2]
    angle = torch.atan2(eyes[-1, 1], eyes[-1, 0]) - torch.atan2(eyes[0, 1], eyes[0, 0])
    assert float(angle) == pytest.approx(0.7, abs=0.03)
    assert camera_arrays(moving).T_camera_world.shape == (30, 4, 4)  # type: ignore[union-attr]


def test_a_way_crosses_a_box_or_not():
    box = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    origin = torch.tensor([-1.0, 0.5, 0.5])
    ends = torch.tensor(
        [[2.0, 0.5, 0.5], [-0.5, 0.5, 0.5], [2.0, 5.0, 0.5], [-2.0, 0.5, 0.5], [0.5, 0.5, 0.5]]
    )
    assert crosses_box(origin, ends, box).tolist() == [True, False, False, False, True]
