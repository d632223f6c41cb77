"""Simulated depth: exact without noise, hidden by boxes, noisy as documented."""

import dataclasses

import numpy as np
import pytest
import torch

from recon.core.camera import depth_camera
from recon.formats.observations import load_observation, save_observation
from recon.simulation.depth import (
    PERFECT,
    DepthSensor,
    PixelSurface,
    depth_image,
    depth_points,
    measured_depth,
    without_pose,
)
from recon.simulation.points import Corruption
from tests import laws


@pytest.fixture(scope="module")
def motion(body):
    return laws.a_motion(body, clips=1, frames=3)[0]


@pytest.fixture(scope="module")
def camera(body, motion):
    middle = body.pose(motion).joints[0, 0]
    away = torch.tensor([2.5, -1.0, 0.3]).double()
    return depth_camera().to(dtype=torch.float64).placed(middle + away, middle)


def test_points_of_a_perfect_sensor_lie_on_the_surface(body, motion, camera):
    file = depth_points(motion, body, camera, Corruption(), 0, sensor=PERFECT, points=300)
    assert len(file.points) == 900
    vertices = body.pose(motion).vertices[torch.from_numpy(file.frame[::10])]
    points = torch.from_numpy(file.points[::10])
    assert (vertices - points[:, None]).norm(dim=-1).amin(-1).max() < 0.03  # between vertices
    pixels = camera.project(points).pixels
    assert torch.allclose(pixels, pixels.floor() + 0.5, atol=1e-6)
    assert file.truth_visible is not None
    assert file.truth_visible.all()


def test_files_keep_what_was_simulated(body, motion, camera, tmp_path):
    file = depth_points(motion, body, camera, Corruption(), 0, points=100)
    save_observation(tmp_path / "depth.npz", file)
    again = load_observation(tmp_path / "depth.npz")
    assert np.array_equal(again.points, file.points)  # type: ignore[union-attr]
    same = depth_points(motion, body, camera, Corruption(), 0, points=100)
    assert np.array_equal(same.points, file.points)


def test_a_box_hides_what_is_behind_it_while_it_is_there(body, motion, camera):
    pelvis = body.pose(motion).joints[:, 0].mean(0)
    eye = camera.T_world_camera[:3, 3]
    middle = (pelvis + eye) / 2
    low = tuple((middle - torch.tensor([0.3, 0.3, 1.5])).tolist())
    high = tuple((middle + torch.tensor([0.3, 0.3, 0.0])).tolist())
    box = Corruption(hide_box=(low, high), during=(0.0, 1.5 / 30))
    file = depth_points(motion, body, camera, box, 0, sensor=PERFECT, points=100_000)
    open_ = depth_points(motion, body, camera, Corruption(), 0, sensor=PERFECT, points=100_000)
    counts, before = np.bincount(file.frame), np.bincount(open_.frame)
    assert counts[0] < 0.8 * before[0]
    assert counts[2] == before[2]
    assert file.truth_visible is not None
    assert not file.truth_visible[0, 7:9].any()  # ankles
    assert file.truth_visible[0, 15]  # head
    assert file.truth_visible[2].all()
    both = depth_points(
        motion, body, camera, box, 0, sensor=PERFECT, points=100_000,
        surfaces=(PixelSurface.BODY, PixelSurface.BOX),
    )  # fmt: skip
    inside = ((both.points > np.array(low) - 1e-6) & (both.points < np.array(high) + 1e-6)).all(1)
    assert inside.sum() > 1000


def test_what_is_below_the_height_gives_no_point_while_it_is_hidden(body, motion, camera):
    """The height was ignored: the cloud showed legs that the file called hidden."""
    low = Corruption(hide_below=0.9, during=(0.0, 1.5 / 30))
    every = (PixelSurface.BODY, PixelSurface.GROUND)
    for surfaces in ((PixelSurface.BODY,), every):
        file = depth_points(
            motion, body, camera, low, 0, points=100_000, surfaces=surfaces
        )  # with noise and flying pixels
        hidden = file.frame < 2
        assert hidden.sum() > 2000
        assert file.points[hidden, 2].min() >= 0.9
        assert file.points[~hidden, 2].min() < 0.5
    assert file.truth_visible is not None
    assert not file.truth_visible[:2, 7:9].any()  # ankles


def test_hiding_leaves_what_is_above_the_height_as_it_was(body, motion, camera):
    low = Corruption(hide_below=0.9)
    seen = depth_points(motion, body, camera, low, 0, sensor=PERFECT, points=100_000)
    whole = depth_points(motion, body, camera, Corruption(), 0, sensor=PERFECT, points=100_000)
    assert np.array_equal(seen.points, whole.points[whole.points[:, 2] >= 0.9])


def test_noise_grows_with_the_square_of_the_depth(camera):
    sensor = DepthSensor()
    for depth in (1.0, 4.0):
        noisy = measured_depth(
            np.full((200, 200), depth), camera, sensor, np.random.default_rng(0)
        )
        assert noisy.std() == pytest.approx(0.0012 + 0.0019 * (depth - 0.4) ** 2, rel=0.03)
    far = measured_depth(np.full((20, 20), 30.0), camera, sensor, np.random.default_rng(0))
    assert (far == 0).all()


def test_edges_have_holes_and_flying_pixels(body, motion, camera):
    vertices, faces = body.pose(motion).vertices[0], body.faces.numpy()
    depth, surface = depth_image(vertices, faces, camera, None)
    seen = measured_depth(depth, camera, DepthSensor(), np.random.default_rng(0))
    person = surface == PixelSurface.BODY
    lost = (seen[person] == 0).mean()
    assert 0.01 < lost < 0.25
    off = np.abs(seen - depth)[person & (seen > 0)]
    assert 0.001 < (off > 0.05).mean() < 0.05


def test_a_sensor_without_pose_gives_points_of_its_own_frame(body, motion, camera):
    file = depth_points(motion, body, camera, Corruption(), 0, points=50)
    own = without_pose(file)
    assert own.camera is not None
    assert own.camera.T_camera_world is None
    assert np.allclose(own.points, camera.to_camera(torch.from_numpy(file.points)).numpy())
    with pytest.raises(ValueError, match="fixed"):
        without_pose(own)


def test_a_sensor_that_looks_away_is_refused(body, motion, camera):
    eye = camera.T_world_camera[:3, 3]
    away = camera.placed(eye, 2 * eye - body.pose(motion).joints[0, 0])
    with pytest.raises(ValueError, match="sees nothing"):
        depth_points(motion, body, away, Corruption(), 0)


def test_joints_beyond_the_reach_of_the_sensor_are_not_in_sight(body, motion, camera):
    """A runner 11 m before a sensor that reaches 8 m counted as seen in every frame."""
    away = camera.project(body.pose(motion).joints).depth
    reach = float(away.median())
    sensor = dataclasses.replace(PERFECT, farthest=reach)
    file = depth_points(motion, body, camera, Corruption(), 0, sensor=sensor, points=100)
    assert file.truth_visible is not None
    assert np.array_equal(file.truth_visible, (away <= reach).numpy())
