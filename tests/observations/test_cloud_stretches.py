"""Clouds in another unit, and recordings in which the person is out of sight for a while."""

import numpy as np
import pytest
import torch

import recon
from recon.core.errors import UnitsError
from recon.formats.observations import PointsFile
from recon.reading.clouds import cloud_of
from tests.filmed import bundled, walk
from tests.observations.test_labelled_start import errors

FRAMES, HIDDEN = 20, slice(7, 13)


def scans(unit: float = 1.0):
    """A walk as 120 points of every frame from all sides, with nothing in the middle."""
    motion, body = walk(FRAMES), bundled()
    vertices = body.pose(motion).vertices.double().numpy()
    random = np.random.default_rng(0)
    seen = [k for k in range(FRAMES) if not HIDDEN.start <= k < HIDDEN.stop]
    chosen = [vertices[k][random.permutation(vertices.shape[1])[:120]] for k in seen]
    points = np.concatenate(chosen) + random.normal(0, 0.01, (120 * len(seen), 3))
    file = PointsFile(unit * points, np.repeat(seen, 120), fps=motion.fps)
    return file, motion, body


def test_a_stretch_without_points_is_bridged():
    file, truth, body = scans()
    cloud = cloud_of(file, body).cloud
    assert not cloud.present[0, HIDDEN].any()
    found = recon.fit(cloud, "pose", repair=False)
    away = errors(found.motion, truth, body).mean(-1)
    assert torch.isfinite(found.joints).all()
    assert away[HIDDEN].mean() < 0.12
    std = found.joint_std
    assert std is not None
    # points of a smooth body told every joint to 6 mm, as if the frames erred independently
    assert std[HIDDEN].median() > 1.2 * std[: HIDDEN.start].median()
    assert std[: HIDDEN.start].median() > 0.012
    assert torch.cat((away[: HIDDEN.start], away[HIDDEN.stop :])).mean() < 0.05


def test_clouds_in_millimetres_are_refused():
    file, _, body = scans(unit=1000.0)
    with pytest.raises((UnitsError, ValueError), match="metres"):
        recon.fit(cloud_of(file, body).cloud, "pose")
