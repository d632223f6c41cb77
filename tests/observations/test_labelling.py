"""Which clouds the bundled network looks at before a fit."""

import pytest
import torch

from observations import depth
from observations.depth import PointCloud
from observations.first_guess import with_labelled_clouds
from observations.joints3d import Joints3D
from observations.surfels import Surfels
from priors.labels.looking import PointLabels
from recon.core.camera import depth_camera
from tests.filmed import bundled, cameras, view, walk


def cloud() -> PointCloud:
    motion, body = walk(3)[None], bundled()
    index = torch.arange(0, len(body.template), 60)
    points = body.pose(motion).points(index)
    present = torch.ones(points.shape[:-1], dtype=torch.bool)
    eye = depth_camera().placed(torch.tensor([0.0, -3.0, 1.0]), torch.tensor([0.0, 0.0, 1.0]))
    sensor = eye.replace(T_camera_world=eye.T_camera_world[None, None])
    return PointCloud(points, present, Surfels.of(body, 300), motion.fps, camera=sensor)


@pytest.fixture
def looked(monkeypatch):
    """What the network is asked, instead of the answers of a trained one."""
    asked: list[tuple[torch.Size, bool, bool]] = []

    def look(points, present, fps, eyes, *, level):
        asked.append((points.shape, eyes is not None, level))
        none = torch.full(present.shape, -1)
        return PointLabels.of_vertices(bundled(), none, present)

    monkeypatch.setattr(depth, "_bundled_labeller", lambda: look)
    return asked


def test_a_cloud_alone_is_looked_at(looked):
    one = cloud()
    (found,) = with_labelled_clouds([one])
    assert isinstance(found, PointCloud)
    assert found.labels is not None
    assert found.labels.present.shape == one.present.shape
    unknown = one.replace(ground_known=False, camera=None)
    with_labelled_clouds([unknown])
    assert looked == [(one.points.shape, True, True), (one.points.shape, False, False)]


def test_a_cloud_beside_keypoints_is_looked_at(looked):
    """Its first guess tried every heading and took four times as long, three times as far off."""
    one, motion = cloud(), walk(3)
    seen = view(motion, cameras(motion)[0])
    same, found = with_labelled_clouds([seen, one])
    assert same is seen
    assert isinstance(found, PointCloud)
    assert found.labels is not None


def test_labels_that_are_given_stay_and_points_with_names_need_none(looked):
    """Joints in space tell the first guess better than labels of points do."""
    one = cloud()
    vertices = torch.zeros_like(one.present).long()
    given = one.replace(labels=PointLabels.of_vertices(bundled(), vertices, one.present))
    assert with_labelled_clouds([given]) == (given,)
    places = bundled().pose(walk(3)[None]).joints
    seen = Joints3D(places, torch.ones_like(places[..., 0]).bool(), tuple(range(22)), 30.0)
    assert with_labelled_clouds([seen, one]) == (seen, one)
    assert looked == []
