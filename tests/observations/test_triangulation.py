"""Points from several views: exact, weighed, and absent where rays say nothing."""

import pytest
import torch

from observations.camera_paths import guess_from_views, triangulate
from tests.filmed import bundled, cameras, joint_error, view, walk

pytestmark = pytest.mark.numerics


def three(noise=0.0):
    truth = walk(8)
    views = [view(truth, c, noise, seed=k) for k, c in enumerate(cameras(truth, 3))]
    true = views[0].points.of(bundled().pose(truth))
    return truth, views, true


def test_exact_views_give_the_exact_points():
    _, views, true = three()
    points, exists = triangulate(views)
    assert exists.all()
    torch.testing.assert_close(points[0], true, atol=2e-4, rtol=0)  # metres
    pair, exists = triangulate(views[:2])
    assert exists.all()
    torch.testing.assert_close(pair[0], true, atol=5e-4, rtol=0)


def test_a_point_needs_two_views():
    _, views, true = three()
    confidence = views[0].confidence.clone()
    confidence[..., 4] = 0
    blind = views[0].replace(confidence=confidence)
    points, exists = triangulate([blind, views[1], views[2]])
    assert exists.all()
    torch.testing.assert_close(points[0], true, atol=5e-4, rtol=0)
    points, exists = triangulate([blind, views[1]])
    assert not exists[..., 4].any()
    assert (points[..., 4, :] == 0).all()
    assert exists[..., :4].all()


def test_an_unsure_view_moves_a_point_less():
    _, views, true = three()
    wrong = views[0].replace(pixels=views[0].pixels + 40.0)
    sure, _ = triangulate([wrong, *views[1:]])
    unsure, _ = triangulate([wrong.replace(confidence=0.1 * wrong.confidence), *views[1:]])
    far = (sure[0] - true).norm(dim=-1).mean()
    near = (unsure[0] - true).norm(dim=-1).mean()
    assert near < 0.1 * far


def test_rays_that_run_side_by_side_meet_nowhere():
    """The same view twice, and two cameras a centimetre apart."""
    truth, views, _ = three()
    points, exists = triangulate([views[0], views[0]])
    assert not exists.any()
    assert (points == 0).all()
    camera = cameras(truth, 3)[0]
    T = camera.T_camera_world.clone()
    T[0, 3] += 0.01
    beside = view(truth, camera.replace(T_camera_world=T), 0.0)
    assert not triangulate([views[0], beside])[1].any()


def test_other_clocks_are_refused():
    truth, views, _ = three()
    slow = view(truth.resample(15.0), cameras(truth, 3)[1])
    with pytest.raises(ValueError, match="expected one layout, frame rate"):
        triangulate([views[0], slow])
    with pytest.raises(ValueError, match="expected one layout, frame rate"):
        triangulate([views[0], views[1].replace(start_time=1.0)])
    other = view(truth, cameras(truth, 3)[1], layout="coco17")
    with pytest.raises(ValueError, match="layout"):
        triangulate([views[0], other])


def test_several_views_start_where_the_person_is():
    truth, views, _ = three(noise=3.0)
    start = guess_from_views(bundled(), views)
    assert start.frames == truth.frames
    assert joint_error(start, truth) < 0.25  # metres; the rest pose has its arms out
    pelvis = bundled().pose(start).joints[..., 0, :] - bundled().pose(truth).joints[..., 0, :]
    assert pelvis.norm(dim=-1).max() < 0.1


def test_views_of_nobody_start_somewhere_finite():
    _, views, _ = three()
    blind = [v.replace(confidence=v.confidence * 0) for v in views]
    start = guess_from_views(bundled(), blind)
    assert all(tensor.isfinite().all() for tensor in start.tensors().values())
