"""Scanned cycles: a new person, seen as said; thinned as the paper's tables do."""

from importlib import resources

import numpy as np
import pytest
import torch

from benchmarks.scans import (
    ScannedCycle,
    observed_frames,
    scanned_cycle,
    thinned_frames,
    thinned_landmarks,
    thinned_points,
)
from recon.body.landmarks import landmark
from recon.core.motion import Motion
from recon.formats.motions import load_motion
from recon.metrics.errors import chamfer_of_clip


@pytest.fixture(scope="module")
def walk(body) -> Motion:
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        return load_motion(path).motion.resample(50.0).window(50, 66).to(dtype=torch.float64)


@pytest.fixture(scope="module")
def cycle(walk, body) -> ScannedCycle:
    return scanned_cycle("demo", "nobody", walk, body)


def test_a_scanned_cycle_is_another_person_who_does_the_same(cycle, walk, body):
    truth, scans = cycle.truth, cycle.scans
    assert truth.frames == 16
    assert truth.fps == scans.fps == cycle.landmarks.fps == 50.0
    assert truth.start_time == scans.start_time == cycle.landmarks.start_time == 0.0
    assert torch.equal(truth.rotations, walk.rotations)
    assert (truth.shape - walk.shape).abs().max() > 0.5
    assert np.bincount(scans.frame).tolist() == [10_000] * 16
    again = scanned_cycle("demo", "nobody", walk, body)
    assert np.array_equal(again.scans.points, scans.points)
    assert np.array_equal(again.landmarks.positions, cycle.landmarks.positions)
    other = scanned_cycle("another", "nobody", walk, body)
    assert not torch.equal(other.truth.shape, truth.shape)


def test_the_truth_is_near_its_scans_and_nobody_else_is(cycle, body):
    few = thinned_frames(cycle.scans, 2)
    floor = chamfer_of_clip(cycle.truth, body, few)
    assert 0.006 < floor < 0.013
    stranger = cycle.truth.replace(shape=-cycle.truth.shape)
    assert chamfer_of_clip(stranger, body, few) > floor + 0.003


def test_landmarks_keep_their_offset_from_the_skin(cycle, body):
    """About 10 mm an axis, constant in the frame of the bone."""
    vertices = [landmark(name) for name in cycle.landmarks.names]
    posed = body.pose(cycle.truth)
    away = torch.from_numpy(cycle.landmarks.positions) - posed.points(torch.tensor(vertices))
    assert 0.007 < away.square().mean().sqrt() < 0.013
    bones = body.weights[vertices].argmax(-1)
    local = (posed.orientations[:, bones].mT @ away[..., None])[..., 0]
    assert local.std(0).max() < 0.003


def test_points_are_thinned_in_every_frame(cycle):
    thin = thinned_points(cycle.scans, 50, 0)
    assert np.bincount(thin.frame).tolist() == [50] * 16
    known = {tuple(point) for point in cycle.scans.points[cycle.scans.frame == 3]}
    assert {tuple(point) for point in thin.points[thin.frame == 3]} <= known
    assert not np.array_equal(thinned_points(cycle.scans, 50, 1).points, thin.points)
    assert np.array_equal(thinned_points(cycle.scans, 20_000, 0).points, cycle.scans.points)
    with pytest.raises(ValueError, match="one point"):
        thinned_points(cycle.scans, 0, 0)


def test_frames_are_those_nearest_to_the_anchors():
    assert observed_frames(100, 5).tolist() == [19, 39, 59, 79, 99]
    assert observed_frames(100, 100).tolist() == list(range(100))
    assert observed_frames(151, 5).tolist() == [29, 59, 89, 120, 150]
    assert observed_frames(16, 100).tolist() == list(range(16))
    assert observed_frames(16, 5).tolist() == [3, 6, 9, 12, 15]
    for wrong in (0, 3, 200):
        with pytest.raises(ValueError, match="divisor"):
            observed_frames(100, wrong)


def test_scans_and_landmarks_are_thinned_alike(cycle):
    scans, landmarks = thinned_frames(cycle.scans, 5), thinned_landmarks(cycle.landmarks, 5)
    assert np.unique(scans.frame).tolist() == [3, 6, 9, 12, 15]
    assert np.bincount(scans.frame)[3] == 10_000
    assert np.flatnonzero(landmarks.visible.any(1)).tolist() == [3, 6, 9, 12, 15]
    assert (landmarks.positions[~landmarks.visible] == 0).all()


def test_cycles_of_another_length_are_refused(walk, body):
    with pytest.raises(ValueError, match="lasts"):
        scanned_cycle("short", "nobody", walk.window(0, 10), body)
