"""Keypoints of detectors on the body: every layout, symmetric, the same posed and at rest."""

import pytest
import torch

from observations.correspondences import PLACES, BodyPoints
from recon.body.landmarks import landmark
from recon.core.layouts import LAYOUTS, keypoint_names
from recon.core.skeleton import JOINTS, joint_index
from tests import laws

layouts = pytest.mark.parametrize("layout", LAYOUTS)


def other_side(name: str) -> str:
    side, _, part = name.partition("_")
    return {"left": f"right_{part}", "right": f"left_{part}"}.get(side, name)


@layouts
def test_every_keypoint_has_a_place_that_is_a_mean(layout, body):
    points = BodyPoints.of_layout(layout, body)
    assert points.names == keypoint_names(layout)
    assert len(set(points.names)) == len(points.names)
    assert points.known.all()
    shares = points.of_joints.sum(-1) + points.of_vertices.sum(-1)
    torch.testing.assert_close(shares, torch.ones(len(points.names)))
    assert (points.of_joints >= 0).all()
    assert (points.of_vertices >= 0).all()
    assert (points.of_vertices.sum(0) > 0).all()  # no vertex without need


def test_places_are_the_means_they_name(body):
    points = BodyPoints.of_layout("halpe26", body)
    posed = body.pose(laws.a_motion(body))
    found = points.of(posed)
    joints, skin = posed.joints, posed.vertices
    hips = joints[..., [joint_index("left_hip"), joint_index("right_hip")], :].mean(-2)
    torch.testing.assert_close(
        found[..., points.names.index("mid_hip"), :], hips, atol=1e-6, rtol=0
    )
    nose = skin[..., landmark("nose"), :]
    torch.testing.assert_close(found[..., 0, :], nose, atol=1e-6, rtol=0)  # metres
    assert PLACES["mid_hip"].joints == ("left_hip", "right_hip")


def test_joints_of_the_model_are_themselves(body):
    posed = body.pose(laws.a_motion(body))
    points = BodyPoints.of_layout("smpl22", body)
    assert points.names == JOINTS
    assert torch.equal(points.of(posed), posed.joints)


@layouts
def test_posing_the_rest_pose_gives_the_points_at_rest(layout, body):
    points = BodyPoints.of_layout(layout, body)
    shape = torch.linspace(-1, 1, body.shape_size).double()[None]
    still = torch.eye(3).double().expand(1, 1, 22, 3, 3)
    motion = laws.Motion.create(torch.zeros(1, 1, 3).double(), still, shape, 30.0)
    torch.testing.assert_close(
        points.of(body.pose(motion))[:, 0], points.at_rest(body, shape), atol=1e-6, rtol=0
    )


@layouts
def test_left_mirrors_right(layout, body):
    points = BodyPoints.of_layout(layout, body)
    rest = points.at_rest(body, torch.zeros(body.shape_size).double())
    mirror = [points.names.index(other_side(name)) for name in points.names]
    flipped = rest[mirror] * rest.new_tensor([-1.0, 1.0, 1.0])
    assert (rest - flipped).norm(dim=-1).max() < 0.02  # metres
    left = [k for k, name in enumerate(points.names) if name.startswith("left_")]
    apart = torch.tensor([points.names[k].split("_")[1] != "mouth" for k in left])
    assert (rest[left, 0][apart] > 0.01).all()  # +x is the body's left


@layouts
def test_a_point_sits_on_the_bone_of_its_name(layout, body):
    """A left hand that follows the right arm would be found by no symmetric test."""
    points = BodyPoints.of_layout(layout, body)
    for name, bone in zip(points.names, points.bones, strict=True):
        side = name.partition("_")[0]
        if side in ("left", "right"):
            assert JOINTS[bone].startswith(side) or JOINTS[bone] in ("head", "neck")


def test_a_body_without_landmarks_has_the_joints_alone(toy_body):
    points = BodyPoints.of_layout("openpose25", toy_body)
    known = {name for name, k in zip(points.names, points.known.tolist(), strict=True) if k}
    assert "left_knee" in known
    assert "mid_hip" in known
    assert not known & {"nose", "left_heel", "right_big_toe", "left_ear"}
    posed = toy_body.pose(laws.a_motion(toy_body))
    found = points.of(posed)
    assert found.shape == (2, 6, 25, 3)
    assert (found[..., ~points.known, :] == 0).all()
    assert len(points.bones) == 25
    assert points.at_rest(toy_body, posed.joints.new_zeros(toy_body.shape_size)).shape == (25, 3)


def test_an_unknown_layout_is_refused_with_those_there_are(body):
    with pytest.raises(ValueError, match="openpose25"):
        BodyPoints.of_layout("kinect", body)
