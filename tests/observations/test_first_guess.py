"""Where a fit begins: the observations that tell most decide."""

import pytest
import torch

from observations.depth import PointCloud
from observations.first_guess import first_guess
from observations.joints3d import Joints3D
from observations.noise import weights_of
from observations.surfels import Surfels
from priors.labels.looking import PointLabels
from recon.core.skeleton import joint_index
from recon.simulation.points import Corruption, joints3d
from tests.filmed import NOISE, bundled, cameras, joint_error, turned, view, walk

pytestmark = pytest.mark.numerics


def views(count: int, **settings):
    truth = walk()
    return truth, [view(truth, c, seed=k, **settings) for k, c in enumerate(cameras(truth, count))]


def joints(truth) -> Joints3D:
    return joints3d(truth, bundled(), Corruption(noise=0.01), 0).map(lambda t: t[None])


def test_one_camera_tells_a_direction_alone():
    truth, seen = views(1)
    guess = first_guess(seen, bundled())
    assert not guess.distance_known
    assert joint_error(guess.motion, truth) < 0.6  # metres


def test_three_cameras_tell_where():
    truth, seen = views(3)
    guess = first_guess(seen, bundled())
    assert guess.distance_known
    assert guess.aligned
    assert joint_error(guess.motion, truth) < 0.1  # 0.2 with limbs as at rest


def test_two_cameras_in_one_place_are_as_one():
    """Their rays met nowhere, and a fit that began there was off by 55 cm."""
    truth, (seen,) = views(1)
    again = view(truth, cameras(truth)[0], seed=7)
    guess = first_guess([seen, again], bundled())
    assert not guess.distance_known
    torch.testing.assert_close(guess.motion.translation, seen.start(bundled()).translation)


def test_arms_do_not_begin_in_front_of_the_points():
    """The rest pose did: no point pulled its arms back, 6.6 cm instead of 1.4."""
    truth, (seen,) = views(1)
    surface = bundled().pose(truth).vertices[None, ::2, ::10]
    present = torch.ones(surface.shape[:-1], dtype=torch.bool)
    cloud = PointCloud(surface, present, Surfels.of(bundled()), truth.fps / 2)
    guess = first_guess([seen, cloud], bundled())
    assert guess.distance_known
    assert guess.motion.fps == seen.fps
    wrists = [joint_index(f"{side}_wrist") for side in ("left", "right")]
    away = bundled().pose(guess.motion).joints - bundled().pose(truth).joints
    assert float(away[..., wrists, :].norm(dim=-1).mean()) < 0.35
    assert joint_error(guess.motion, truth) < 0.2


def test_labels_tell_where_a_body_in_an_image_faces():
    """The root came from the image alone, however well the points beside it were known."""
    truth = turned(walk(12), 2.0)
    seen = view(truth, cameras(truth)[0])
    body, surfels = bundled(), Surfels.of(bundled())
    index = torch.arange(0, len(body.template), 25)
    points = body.pose(truth[None]).points(index)
    present = torch.ones(points.shape[:-1], dtype=torch.bool)
    labels = PointLabels.of_vertices(body, index.expand(points.shape[:-1]), present)
    cloud = PointCloud(points, present, surfels, truth.fps, labels=labels)
    guess = first_guess([seen, cloud], body)
    assert joint_error(guess.motion, truth) < 0.1


def test_names_come_before_images_in_any_order():
    truth, seen = views(1)
    named = joints(truth)
    for observations in ([seen[0], named], [named, seen[0]]):
        guess = first_guess(observations, bundled())
        assert guess.distance_known
        torch.testing.assert_close(guess.motion.translation, named.start(bundled()).translation)


def test_views_with_clocks_of_their_own_do_not_spoil_the_start():
    truth, seen = views(3)
    slow = view(truth.resample(15.0), cameras(truth, 3)[2])
    guess = first_guess([*seen[:2], slow], bundled())
    assert guess.distance_known
    assert joint_error(guess.motion, truth) < 0.25
    alone = first_guess([seen[0], slow], bundled())
    assert not alone.distance_known


def test_a_pixel_is_as_wide_as_its_distance_says():
    truth, (seen,) = views(1)
    guess = truth.map(lambda t: t[None])
    depth = seen.camera.to_camera(bundled().pose(guess).joints[..., :1, :])[..., 2].median()
    assert abs(seen.pixel_size(guess, bundled()) * 1500.0 / float(depth) - 1) < 0.05


def test_noise_in_pixels_is_found_and_weighed_against_metres():
    truth, (seen,) = views(1)
    named = joints(truth)
    guess = truth.map(lambda t: t[None])
    pixels = seen.noise(guess, bundled())
    metres = named.noise(guess, bundled())
    # of 3 pixels; a detector is taken to err by a centimetre at the body at least
    least = 0.01 / seen.pixel_size(guess, bundled())
    assert abs(pixels.own / max(NOISE, least) - 1) < 0.25
    assert metres.own == metres.metres
    told = seen.noise(guess, bundled(), 5.0)
    assert told.own == 5.0
    weights = weights_of([told, metres])
    sizes = [weights[0] * told.own**2, weights[1] * metres.own**2]
    assert abs(sizes[0] - sizes[1]) < 1e-9
    assert max(weights) <= 1.0 + 1e-6 or told.metres < metres.metres


def test_limbs_begin_where_their_points_are():
    """Arms began stretched out to the sides; a fit spent half its steps on bringing them in."""
    truth = walk()
    begun = joints(truth).start(bundled())
    away = (bundled().pose(begun).joints[0] - bundled().pose(truth).joints).norm(dim=-1)
    limbs = [joint_index(f"{side}_{name}") for side in ("left", "right")
             for name in ("knee", "ankle", "elbow", "wrist")]  # fmt: skip
    assert away[:, limbs].mean() < 0.06  # metres; the rest pose has 0.4


def test_a_limb_that_nobody_saw_begins_at_rest():
    """Others are turned all the same, and what was seen for a while holds before and after."""
    seen = joints(walk())
    left, right = joint_index("left_wrist"), joint_index("right_wrist")
    visible = seen.visible.clone()
    visible[..., left] = False
    visible[..., 5:, right] = False
    begun = seen.replace(visible=visible).start(bundled())
    elbow = begun.rotations[0, :, joint_index("left_elbow")]
    torch.testing.assert_close(elbow, torch.eye(3).expand_as(elbow))
    held = begun.rotations[0, 4:, joint_index("right_elbow")]
    torch.testing.assert_close(held, held[:1].expand_as(held))
    assert (held[0] - torch.eye(3)).norm() > 0.1
