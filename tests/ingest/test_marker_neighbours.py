"""Gaps of single markers: poses that they leave open come from the frames around them."""

import dataclasses

import numpy as np
import pytest
import torch

from recon.body.derivatives import inverse_right_jacobian
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.ingest.marker_fit import fit_markers
from recon.ingest.marker_gaps import observed_joints
from recon.ingest.marker_neighbours import (
    _precision_band,
    _smoothed_over_time,
    frames_about_gaps,
)
from recon.ingest.marker_sets import full_body_markers
from recon.mocap.recording import MarkerRecording


def with_gaps(recording: MarkerRecording) -> MarkerRecording:
    """Every marker is hidden once, for 0.2 to 0.5 s: a third of all positions."""
    random = np.random.default_rng(0)
    visible = np.ones_like(recording.visible)
    for marker in range(visible.shape[1]):
        length = int(random.integers(6, 15))
        start = int(random.integers(0, recording.frames - length))
        visible[start : start + length, marker] = False
    positions = np.where(visible[..., None], recording.positions, 0.0)
    return dataclasses.replace(recording, visible=visible, positions=positions)


def test_gaps_are_filled_by_the_frames_around_them(
    markers: MarkerRecording,
    walk: Motion,
    single: BodyModel,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Joints whose markers were hidden fell back to the natural pose within two frames: hidden
    markers were 27 mm off, joints 12 mm; with all markers shown, joints are 5.5 mm off."""
    monkeypatch.setattr("recon.ingest.marker_neighbours._AT_ONCE", 7)  # long recordings: parts
    gappy = with_gaps(markers)
    where = full_body_markers(gappy, single)
    fit = fit_markers(gappy, where, single)
    away = np.linalg.norm(fit.predicted.numpy() - markers.positions, axis=-1)
    assert away[~gappy.visible].mean() < 0.006
    assert away[gappy.visible].mean() < 0.002
    joints = single.pose(fit.motion).joints - single.pose(walk).joints
    assert joints.norm(dim=-1).mean() < 0.008
    visible = torch.from_numpy(gappy.visible)
    assert torch.equal(fit.observed, observed_joints(visible, where.vertices, single))


def test_recordings_without_gaps_are_solved_as_they_are(
    markers: MarkerRecording, single: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What neighbours in time say costs time, and full frames need none of it."""

    def refuse(*_: object) -> None:
        raise AssertionError("no marker is hidden")

    monkeypatch.setattr("recon.ingest.marker_fit.fitted_about_gaps", refuse)
    where = full_body_markers(markers, single)
    assert fit_markers(markers, where, single).motion.frames == markers.frames
    visible = markers.visible.copy()
    visible[:, 3] = False  # a marker that is never seen leaves no gap
    without = dataclasses.replace(markers, visible=visible)
    chosen = full_body_markers(without, single)
    fit_markers(without.select(chosen.labels), chosen, single)


def test_frames_about_gaps_reach_half_a_second() -> None:
    visible = torch.ones(100, 3, dtype=torch.bool)
    visible[:, 2] = False
    visible[50:53, 0] = False
    about = frames_about_gaps(visible, 20.0)
    assert about.nonzero()[:, 0].tolist() == list(range(40, 63))


def test_the_jacobian_of_rotation_vectors() -> None:
    turns = torch.tensor(
        [[0.0, 0.0, 0.0], [1e-3, 2e-3, 0.0], [0.4, -1.1, 0.8], [1.6, 2.2, -1.5]]
    ).double()
    found = inverse_right_jacobian(turns)
    for axis in range(3):
        step = torch.zeros(3).double()
        step[axis] = 1e-6
        ahead = so3.log(so3.exp(turns) @ so3.exp(step))
        behind = so3.log(so3.exp(turns) @ so3.exp(-step))
        torch.testing.assert_close(found[..., axis], (ahead - behind) / 2e-6, atol=1e-5, rtol=0)


def test_a_joint_is_smoothed_as_its_process_asks() -> None:
    """The banded solution is the posterior mean by full matrices; where nothing is known of a
    joint, it goes from one side to the other, and back to its mean far from both."""
    random = np.random.default_rng(1)
    moments, step = torch.tensor([0, 1, 2, 6, 7, 40]), 0.05
    root = random.standard_normal((6, 21, 3, 3))
    known = torch.from_numpy(root @ root.swapaxes(-1, -2))
    known[2] = 0.0
    values = torch.from_numpy(random.standard_normal((6, 21, 3)))
    found = _smoothed_over_time(known, values, moments, step)
    band = _precision_band(41, step)
    full = sum(np.diag(band[k, : 123 - k], -k) for k in range(7))
    full = full + np.tril(full, -1).T
    right = np.zeros(123)
    for row, moment in enumerate(moments.tolist()):
        at = slice(3 * moment, 3 * moment + 3)
        full[at, at] += known[row, 4].numpy()
        right[at] = (known[row, 4] @ values[row, 4]).numpy()
    expected = np.linalg.solve(full, right).reshape(-1, 3)[moments.numpy()]
    np.testing.assert_allclose(found[:, 4].numpy(), expected, atol=1e-9)
    sure = 1e6 * torch.eye(3).double().expand(3, 21, 3, 3).clone()
    sure[1] = 0.0
    ends = torch.tensor([1.0, 0.0, 1.0]).double()[:, None, None].expand(3, 21, 3)
    near = _smoothed_over_time(sure, ends, torch.tensor([0, 2, 4]), step)
    far = _smoothed_over_time(sure, ends, torch.tensor([0, 40, 80]), step)
    assert near[1].min() > 0.9
    assert far[1].abs().max() < 0.01
