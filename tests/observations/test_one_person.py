"""Clouds that show two people, or a person and other things."""

import numpy as np
import pytest
import torch

import recon
from observations.depth import PointCloud
from recon.core.camera import depth_camera
from recon.core.errors import ObservationError
from recon.formats.observations import CameraArrays, PointsFile, save_observation
from recon.reading.clouds import cloud_of, clusters_of_one_person
from recon.simulation.depth import PixelSurface, depth_points
from recon.simulation.points import Corruption
from recon.simulation.scenery import box
from recon.simulation.settings import FilmSettings, SurfaceSettings
from tests.filmed import bundled
from tests.verbs import simulate_file
from tests.walking import a_walk


def people(frames: int = 12, apart: float = 1.5):
    """Two standing boxes of points; which of them has more points changes in every frame."""
    random = np.random.default_rng(0)
    clouds = []
    for k in range(frames):
        counts = (600, 500) if k % 2 else (500, 600)
        one, other = (
            random.uniform((-0.2, -0.2, 0.0), (0.2, 0.2, 1.7), (n, 3))
            + np.eye(3)[0] * (x + 0.02 * k)
            for n, x in zip(counts, (0.0, apart), strict=True)
        )
        clouds.append(np.concatenate((one, other)))
    return clouds


def test_one_of_two_people_is_followed():
    """The largest thing of every frame was taken, so the body flew between two people."""
    clouds = people()
    found, beside = clusters_of_one_person(clouds, 0.2)
    assert beside == len(clouds)
    middles = np.array([cloud.mean(0)[0] - 0.02 * k for k, cloud in enumerate(found)])
    assert np.ptp(middles) < 0.1


def test_a_person_alone_and_limbs_cut_off_by_an_occluder_are_no_company():
    whole = [cloud[cloud[:, 0] < 0.75] for cloud in people()]
    assert clusters_of_one_person(whole, 0.2)[1] == 0
    lying = [cloud[:, [2, 1, 0]] for cloud in whole]
    divided = [cloud[np.abs(cloud[:, 0] - 1.0) > 0.15] for cloud in lying]
    assert clusters_of_one_person(divided, 0.2)[1] == 0


def test_empty_frames_stay_empty():
    clouds = people()
    clouds[3] = clouds[3][:0]
    found, _ = clusters_of_one_person(clouds, 0.2)
    assert len(found[3]) == 0
    assert clusters_of_one_person([clouds[3]], 0.2)[1] == 0


@pytest.mark.parametrize("posed", [False, True])
def test_a_wall_behind_the_person_is_left_out(posed, body):
    """Without a ground in sight, the wall was the largest thing, and a body 5.8 m tall was fitted
    to it."""
    random = np.random.default_rng(0)
    person = random.uniform((-0.2, -0.8, 1.9), (0.2, 0.9, 2.1), (400, 3))
    wall = np.append(random.uniform((-1.5, -1.2), (1.5, 1.2), (4000, 2)), np.full((4000, 1), 3), 1)
    wall[:, 2] += 0.2 * wall[:, 0] + random.normal(0, 0.01, 4000)
    level = np.array([[1.0, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, 0], [0, 0, 0, 1]])
    size = np.array([[525.0, 0, 320], [0, 525, 240], [0, 0, 1]])
    camera = CameraArrays(size, (640, 480), None, level[None] if posed else None)
    points = np.concatenate((wall, person))
    if posed:
        points = (points - level[:3, 3]) @ level[:3, :3]
    file = PointsFile(np.tile(points, (3, 1)), np.repeat(np.arange(3), len(points)), 30.0, camera)
    cloud = cloud_of(file, body, points=1000).cloud
    assert cloud.present.sum(-1).tolist() == [[400] * 3]
    assert np.ptp(cloud.points[cloud.present].numpy(), axis=0).max() < 1.8


@pytest.mark.parametrize("camera", ["front", "side"])
def test_who_walks_straight_before_a_sensor_stays_whole(camera, tmp_path):
    """The way of a walker was taken for a wall, and up to half of the body was left out: joints of
    every straight walk were 44 cm off."""
    recon.save_motion(tmp_path / "truth.npz", a_walk(bundled(), seconds=2.0, fps=5.0))
    film, surface = FilmSettings(camera=camera), SurfaceSettings(points=500)
    path = tmp_path / "seen.npz"
    simulate_file(
        tmp_path / "truth.npz", path, "depth", Corruption(), seed=0, film=film, surface=surface
    )
    cloud = recon.load_observation(path)
    assert isinstance(cloud, PointCloud)
    with np.load(path) as file:
        assert cloud.present.sum(-1)[0].tolist() == np.bincount(file["frame"]).tolist()


@pytest.mark.parametrize("left", [(), (PixelSurface.GROUND,)])
def test_a_wall_behind_a_walker_is_left_out_and_the_walker_is_not(left, tmp_path):
    walk = a_walk(bundled(), seconds=1.6, fps=5.0)
    camera = depth_camera().placed(torch.tensor([2.6, 1.0, 1.0]), torch.tensor([0.0, 1.0, 1.0]))
    seen = depth_points(
        walk, bundled(), camera, Corruption(), 0, points=20_000,
        surfaces=(PixelSurface.BODY, PixelSurface.FURNITURE, *left),
        furniture=box((0.1, 9.0, 3.0)).placed((-1.5, 1.0, 0.0)),
    )  # fmt: skip
    save_observation(tmp_path / "seen.npz", seen)
    cloud = recon.load_observation(tmp_path / "seen.npz")
    assert isinstance(cloud, PointCloud)
    assert cloud.present.all()
    joints = bundled().pose(walk).joints
    assert (torch.cdist(cloud.points[0], joints).amin(-1) < 0.3).float().mean() > 0.98


@pytest.mark.parametrize("hand", [0, 100])
def test_a_ground_with_nobody_on_it_is_refused(body, hand):
    """The noise of the ground was taken for a person: a runner had been out of the sensor's reach,
    but for a hand in one frame, and a body was fitted 1.7 m wrong."""
    random = np.random.default_rng(0)
    frames = 40
    ground = random.uniform((-3, -3, 0), (3, 3, 0), (frames * 2000, 3))
    ground[:, 2] += random.normal(0, 0.02, len(ground))
    ground[:hand] = random.normal((0, 0, 1), 0.05, (hand, 3))
    level = np.array([[1.0, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, 4], [0, 0, 0, 1]])
    matrix = np.array([[525.0, 0, 320], [0, 525, 240], [0, 0, 1]])
    camera = CameraArrays(matrix, (640, 480), T_camera_world=level[None])
    file = PointsFile(ground, np.repeat(np.arange(frames), 2000), fps=30.0, camera=camera)
    with pytest.raises(ObservationError, match="nobody is in the"):
        cloud_of(file, body)
