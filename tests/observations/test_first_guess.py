"""Where a fit begins: the observations that tell most decide."""

import pytest
import torch

from observations import Joints3D
from observations.noise import weights_of
from observations.together.first_guess import first_guess
from recon.simulation.points import Corruption, joints3d
from tests.filmed import NOISE, bundled, cameras, joint_error, view, walk

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
    assert joint_error(guess.motion, truth) < 0.25


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
