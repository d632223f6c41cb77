"""Chamfer distance: known for simple sets, of the right frames, in metres."""

from importlib import resources

import numpy as np
import pytest

from recon.core.camera import full_hd_camera
from recon.formats.motions import load_motion
from recon.formats.observations import PointsFile
from recon.metrics.errors import chamfer, chamfer_of_clip
from recon.simulation.images import camera_arrays
from recon.simulation.points import Corruption, scan_points


@pytest.fixture(scope="module")
def walk(body):
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        return load_motion(path).motion.window(30, 36)


def grid(step, height=0.0):
    across = np.arange(0.0, 1.0, step)
    x, y = np.meshgrid(across, across)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], 1)


def test_distances_of_simple_sets():
    assert chamfer(grid(0.1), grid(0.1)) == 0.0
    assert chamfer(grid(0.1), grid(0.1, 0.03)) == pytest.approx(0.03)
    one = np.zeros((1, 3))
    two = np.array([[0.3, 0.0, 0.4], [0.0, 1.0, 0.0]])
    assert chamfer(one, two) == pytest.approx((0.5 + (0.5 + 1.0) / 2) / 2)
    assert chamfer(two, one) == chamfer(one, two)


def test_nothing_has_no_distance():
    with pytest.raises(ValueError, match="0 points"):
        chamfer(grid(0.1), np.zeros((0, 3)))


def test_vertices_themselves_are_at_zero_at_any_rate(body, walk):
    """Scans at half the rate, beginning later: frames meet by their time."""
    walk = walk.to(dtype=body.template.dtype).replace(start_time=4.0)
    vertices = body.pose(walk).vertices.numpy()[2::2]
    frame = np.repeat(np.arange(len(vertices)), vertices.shape[1])
    fps, start = walk.fps / 2, 4.0 + 2 / walk.fps
    order = np.random.default_rng(0).permutation(len(frame))
    scans = PointsFile(vertices.reshape(-1, 3)[order], frame[order], fps, start_time=start)
    assert chamfer_of_clip(walk, body, scans) < 1e-9
    shifted = PointsFile(scans.points, scans.frame, fps, start_time=start - 1 / walk.fps)
    assert chamfer_of_clip(walk, body, shifted) > 1e-3
    late = PointsFile(scans.points, scans.frame, fps, start_time=9.0)
    with pytest.raises(ValueError, match="lasts from"):
        chamfer_of_clip(walk, body, late)


def test_a_displaced_body_is_farther_than_the_true_one(body, walk):
    walk = walk.to(dtype=body.template.dtype)
    scans = scan_points(walk, body, Corruption(noise=0.005), 0, points=3000)
    true = chamfer_of_clip(walk, body, scans)
    assert 0.006 < true < 0.012
    away = walk.replace(translation=walk.translation + walk.translation.new_tensor([0.1, 0, 0]))
    assert chamfer_of_clip(away, body, scans) > true + 0.02


def test_points_without_a_place_are_refused(body, walk):
    camera = camera_arrays(full_hd_camera())
    scans = PointsFile(np.zeros((1, 3)), np.zeros(1, np.int64), 30.0, camera)
    unplaced = PointsFile(
        scans.points, scans.frame, 30.0, type(camera)(camera.camera_matrix, camera.image_size)
    )
    with pytest.raises(ValueError, match="without a pose"):
        chamfer_of_clip(walk, body, unplaced)
    nothing = PointsFile(np.zeros((0, 3)), np.zeros(0, np.int64), 30.0)
    with pytest.raises(ValueError, match="none"):
        chamfer_of_clip(walk, body, nothing)
