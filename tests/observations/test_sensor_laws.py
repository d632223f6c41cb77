"""Laws of sensors: what a fit asks of each of them, the example's own sensor included."""

import math

import numpy as np
import pytest
import torch

from observations.correspondences import BodyPoints
from observations.depth import PointCloud
from observations.joints3d import Joints3D
from observations.keypoints3d import Keypoints3D
from observations.markers3d import Markers3D
from observations.surfels import Surfels
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method.sensor import Sensor
from recon.reading.images import keypoints_of
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests import laws, own_of_0_2
from tests.filmed import bundled, cameras, walk
from tests.own import units

FRAMES = 8
KINDS = ("joints", "weighted", "markers", "keypoints", "relative", "camera", "cloud", "own", "old")


def truth() -> Motion:
    """Part of the walk, on a clock that does not begin at zero."""
    return walk(FRAMES, 20).replace(start_time=0.5)


def exact(kind: str) -> Sensor:
    """What a sensor without noise sees of it."""
    body, motion = bundled(), truth()
    posed, clock = body.pose(motion), (motion.fps, motion.start_time)
    if kind in ("joints", "weighted"):
        std = np.linspace(0.01, 0.03, FRAMES * 22).reshape(FRAMES, 22)
        seen = np.ones((FRAMES, 22), bool)
        std = std if kind == "weighted" else None
        return Joints3D(posed.joints, seen, tuple(range(22)), *clock, std=std)
    if kind == "markers":
        places = (0, 700, 1400, 2100)
        seen = posed.points(torch.tensor(places))
        return Markers3D(seen, np.ones((FRAMES, 4), bool), places, *clock)
    if kind in ("keypoints", "relative"):
        points = BodyPoints.of_layout("mediapipe33", body)
        places, seen = points.of(posed), np.ones((FRAMES, 33), bool)
        if kind == "keypoints":
            return Keypoints3D(places, seen, points, *clock)
        places = places - places[:, 23:25].mean(1, keepdim=True)
        return Keypoints3D(places, seen, points, *clock, placed=False)
    if kind == "camera":
        file = keypoints2d(motion, body, cameras(motion)[0], Corruption(noise=0.0), 0)
        return keypoints_of(file, body)[0]
    if kind == "cloud":
        points = posed.vertices[:, ::40]
        return PointCloud(points, np.ones(points.shape[:2], bool), Surfels.of(body), *clock)
    own = units(motion, body, noise=0.0).replace(start_time=motion.start_time)
    if kind == "own":
        return own
    return own_of_0_2.Imus(own.values, own.shown, own.bones, own.fps, own.start_time)


def residuals(seen: Sensor, motion: Motion) -> torch.Tensor:
    """Lengths of the residuals of one clip, moments by points."""
    return seen[None].residuals(laws.Estimate.of_clip(motion, bundled())).distances[0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_keeps_the_protocol(kind):
    seen = exact(kind)
    assert isinstance(seen, Sensor)
    assert seen.clips == ()
    assert seen[None].clips == (1,)
    assert seen.moments == FRAMES == seen.shown.shape[0]
    names = seen.point_names(bundled())
    assert len(names) in (0, seen.shown.shape[1])
    assert len(set(names)) == len(names)
    assert seen.kind == seen.kind.lower()


@pytest.mark.parametrize("kind", KINDS)
def test_energies_are_those_of_a_batch_and_vanish_at_the_truth(kind):
    body, both = bundled().to(dtype=torch.float64), torch.tensor([0, 0])
    motion = truth()[None].to(dtype=torch.float64)[both]
    seen = exact(kind)[None].to(dtype=torch.float64)[both]
    near = motion.replace(translation=motion.translation + 0.03)
    laws.check_energy(seen, body, near, None)
    at_truth = seen(laws.estimate_of(body, motion))
    assert float(at_truth.max()) < 0.01 * max(
        float(seen(laws.estimate_of(body, tilted(near))).min()), 1e-3
    )


def tilted(motion: Motion) -> Motion:
    """All joints turned a little."""
    turn = so3.exp(motion.translation.new_tensor([0.1, 0.1, -0.1]))
    return motion.replace(rotations=motion.rotations @ turn)


@pytest.mark.parametrize("kind", KINDS)
def test_a_window_sees_what_the_whole_saw_then(kind):
    seen, motion = exact(kind), tilted(truth())
    first, last = 2, 5
    part = seen.window(0.5 + first / 30, 0.5 + last / 30)
    assert part.moments == last - first + 1
    assert part.start_time == pytest.approx(0.5 + first / 30)
    expected = residuals(seen, motion)[first : last + 1]
    torch.testing.assert_close(residuals(part, motion), expected, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_seen_beyond_the_data_and_the_clock_runs_on(kind):
    part = exact(kind).window(0.5 - 2 / 30, 0.5 + 3 / 30)
    assert part.moments == 6
    assert part.shown.any(-1).tolist() == [False, False, True, True, True, True]
    assert part.start_time == pytest.approx(0.5 - 2 / 30)
    assert bool(residuals(part, tilted(truth())).isfinite().all())


@pytest.mark.parametrize("kind", KINDS)
def test_data_can_be_given_in_another_frame(kind):
    T = np.eye(4)
    T[:3, :3] = so3.exp(torch.tensor([0.3, -0.2, 1.0])).numpy()
    T[:3, 3] = (1.0, -2.0, 0.4)
    seen, motion = exact(kind), tilted(truth())
    like = motion.translation
    there = motion.carried(torch.from_numpy(T).to(like), bundled().rest_joints(motion.shape)[0])
    expected = residuals(seen, motion)
    torch.testing.assert_close(
        residuals(seen.transformed(T), there),
        expected,
        atol=2e-3 * float(expected.max()),
        rtol=1e-3,
    )


@pytest.mark.parametrize("kind", KINDS)
def test_noise_is_as_given_and_tells_metres_at_the_body(kind):
    seen, guess = exact(kind)[None], truth()[None]
    found, given = seen.noise(guess, bundled()), seen.noise(guess, bundled(), 0.5)
    assert 0.001 < found.metres < 0.2
    assert given.own >= 0.5
    assert given.own / given.metres == pytest.approx(found.own / found.metres, rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_fewer_moments_are_enough_for_a_quick_comparison(kind):
    seen, motion = exact(kind)[None], truth()[None]
    few = seen.coarse(bundled(), 2)
    assert few.moments * (30 / few.fps) == pytest.approx(FRAMES, abs=1)
    assert few.start_time == seen.start_time
    scene = Scene.create(1, like=motion.translation)
    value = few(laws.Estimate(laws.Decoded(motion), bundled().pose(motion), scene))
    assert value.shape == (1,)
    assert math.isfinite(float(value))


@pytest.mark.parametrize("kind", KINDS)
def test_a_first_guess_is_on_the_sensor_s_clock(kind):
    seen = exact(kind)[None]
    start = seen.start(bundled())
    assert start.translation.shape == (1, FRAMES, 3)
    assert start.fps == seen.fps
    assert start.start_time == seen.start_time
    assert bool(start.rotations.isfinite().all())


@pytest.mark.parametrize("kind", KINDS)
def test_joints_are_shown_at_the_sensor_s_moments(kind):
    estimate = laws.Estimate.of_clip(truth(), bundled())
    shown = exact(kind)[None].shown_joints(estimate)
    assert shown.shape == (FRAMES, 22)
    assert shown.dtype == np.bool_
