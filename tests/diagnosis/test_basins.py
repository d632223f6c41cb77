"""Fits to depth that settled in a wrong posture or heading are said, noisy ones are not."""

import torch

from observations.depth import PointCloud
from observations.surfels import Surfels
from priors.labels.looking import PointLabels
from recon.core.camera import depth_camera
from recon.core.residuals import Noise
from recon.diagnosis.basins import basin_findings, distance_from_labelled_places
from recon.diagnosis.examination import summarise
from tests import laws
from tests.filmed import bundled, turned, walk

FRAMES = 6


def scene(noise: float = 0.005, std: float = 0.01):
    """A labelled cloud of what faces a sensor, and the walk it is of."""
    motion, body = walk(FRAMES)[None], bundled()
    surfels = Surfels.of(body)
    middle = body.pose(motion).joints[0, :, 0].mean(0)
    camera = depth_camera().placed(middle + torch.tensor([0.3, -3.0, 0.2]), middle)
    eye = camera.T_world_camera[:3, 3]
    middles, normals = surfels.posed(body.pose(motion))
    facing = ((eye - middles) * normals).sum(-1) > 0
    g = torch.Generator().manual_seed(0)
    order = (facing + torch.rand(facing.shape, generator=g) / 2).argsort(-1, descending=True)
    index = order[..., :400]
    points = middles.gather(-2, index[..., None].expand(*index.shape, 3))
    away = torch.nn.functional.normalize(points - eye, dim=-1)
    points = points + noise * away * torch.randn(*index.shape, 1, generator=g)
    present = facing.gather(-1, index)
    vertices = torch.from_numpy(surfels.vertices)[index]
    labels = PointLabels.of_vertices(body, vertices, present)
    view = camera.replace(T_camera_world=camera.T_camera_world[None, None])
    cloud = PointCloud(
        points, present, surfels, motion.fps, camera=view, labels=labels,
        std=torch.full((1, FRAMES), std),
    )  # fmt: skip
    return cloud, motion, body


def said(cloud, motion, body):
    estimate = laws.estimate_of(body, motion)
    summary = summarise("cloud", cloud, Noise(0.01, 0.01), estimate)
    return basin_findings("cloud", cloud, summary.quantiles, estimate)


def test_a_turned_body_is_said():
    """A back that was taken for a chest was 27 cm off, and near every point."""
    cloud, motion, body = scene()
    assert said(cloud, motion, body) == []
    there = distance_from_labelled_places(cloud, laws.estimate_of(body, motion))
    assert there is not None
    assert there < 0.05
    wrong = turned(motion[0], torch.pi)[None]
    pelvis, place = (body.pose(m).joints[:, :, :1] for m in (wrong, motion))
    wrong = wrong.replace(translation=wrong.translation + (place - pelvis)[:, :, 0])
    (finding,) = said(cloud, wrong, body)
    assert finding.code == "wrong basin"
    assert "look like" in finding.message
    assert (
        distance_from_labelled_places(cloud.replace(labels=None), laws.estimate_of(body, wrong))
        is None
    )


def test_legs_below_the_image_speak_against_nothing():
    """Somebody seen from the waist up was fitted well, and called a wrong posture for the legs."""
    cloud, motion, body = scene()
    assert cloud.camera is not None
    width, height = cloud.camera.image_size
    cut = cloud.camera.replace(image_size=(width, height // 2))
    pixels = cloud.camera.project(cloud.points).pixels
    present = cloud.present & cut.in_image(pixels)
    assert 0.3 < present.sum() / cloud.present.sum() < 0.7
    assert cloud.labels is not None
    waist_up = cloud.replace(present=present, labels=cloud.labels.replace(present=present))
    assert said(waist_up.replace(camera=cut), motion, body) == []
    (finding,) = said(waist_up, motion, body)
    assert "saw no body" in finding.message


def test_clouds_without_labels_are_labelled_to_be_judged(monkeypatch):
    """Fits that began at a given motion were 27 cm off without a word: nothing had labels."""
    cloud, motion, body = scene()
    bare = cloud.replace(labels=None)
    monkeypatch.setattr(PointCloud, "labelled", lambda one: one.replace(labels=cloud.labels))
    wrong = turned(motion[0], torch.pi)[None]
    pelvis, place = (body.pose(m).joints[:, :, 0] for m in (wrong, motion))
    (finding,) = said(bare, wrong.replace(translation=wrong.translation + place - pelvis), body)
    assert "look like" in finding.message


def test_the_noise_of_a_far_sensor_is_no_wrong_posture():
    """Whoever is seen 6 m away is seen with 7 cm of noise, and was said to be fitted wrongly."""
    far, motion, body = scene(noise=0.07, std=0.07)
    assert said(far, motion, body) == []
    near = far.replace(std=torch.full((1, FRAMES), 0.01))
    assert "a tenth of the points" in said(near, motion, body)[0].message


def test_a_fit_that_is_wrong_for_a_part_of_the_clip_is_said():
    """The median over the moments said nothing of a walk that was wrong for a third of it."""
    cloud, motion, body = scene()
    wrong = motion.rotations.clone()
    wrong[:, :2, 0] = turned(motion[0], torch.pi).rotations[:2, 0]
    other = motion.replace(rotations=wrong)
    pelvis, place = (body.pose(m).joints[:, :, 0] for m in (other, motion))
    other = other.replace(translation=other.translation + place - pelvis)
    (finding,) = said(cloud, other, body)
    assert "look like" in finding.message


def test_points_on_no_body_are_said():
    """What a sensor saw of a chair and a table was fitted as a person."""
    cloud, motion, body = scene()
    assert cloud.labels is not None
    furniture = cloud.labels.derived(on_body=0.4 * cloud.labels.on_body)
    (finding,) = said(cloud.replace(labels=furniture), motion, body)
    assert "no body" in finding.message
