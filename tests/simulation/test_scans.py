"""Simulated scans: all over the posed surface, other points every frame; folders read back."""

import numpy as np
import pytest
import torch

from recon.formats.observations import PointsFile
from recon.formats.scans import read_scans, write_scans
from recon.simulation.points import Corruption, sampled_on_surface, scan_points
from tests import laws


@pytest.fixture(scope="module")
def motion(body):
    return laws.a_motion(body, clips=1, frames=3)[0]


def test_scans_cover_the_body_from_all_sides(body, motion):
    file = scan_points(motion, body, Corruption(noise=0.001, missing_frames=0.4), 2, points=500)
    assert set(np.bincount(file.frame, minlength=3).tolist()) <= {0, 500}
    vertices = body.pose(motion).vertices[torch.from_numpy(file.frame[::7])]
    points = torch.from_numpy(file.points[::7])
    assert (vertices - points[:, None]).norm(dim=-1).amin(-1).max() < 0.025


def test_points_of_frames_are_other_points_of_the_surface(body, motion):
    still = motion.replace(
        translation=motion.translation[:1].expand(3, 3),
        rotations=motion.rotations[:1].expand(3, 22, 3, 3),
    )
    clouds = scan_points(still, body, Corruption(), 0, points=200).points.reshape(3, 200, 3)
    assert np.linalg.norm(clouds[0] - clouds[1], axis=1).min() > 1e-6
    same = scan_points(still, body, Corruption(), 0, points=200)
    assert np.array_equal(same.points, clouds.reshape(-1, 3))


def test_points_are_uniform_by_area():
    """A square of one large and many small triangles is covered evenly."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.9, 0.9, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 4], [3, 2, 4], [1, 4, 2]])
    points = sampled_on_surface(corners, faces, 40_000, np.random.default_rng(0))
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=4, range=[[0, 1], [0, 1]])[0]
    assert np.abs(counts / 2500 - 1).max() < 0.08  # 4 standard deviations
    assert (points[:, 2] == 0).all()


def test_impossible_scans_are_refused(body, motion):
    with pytest.raises(ValueError, match="one point"):
        scan_points(motion, body, Corruption(), 0, points=0)
    with pytest.raises(ValueError, match="hides every point"):
        scan_points(motion, body, Corruption(hide_below=9.0), 0, points=10)


def test_a_folder_of_scans_reads_back(body, motion, tmp_path):
    file = scan_points(motion.replace(start_time=2.5), body, Corruption(), 0, points=50)
    middle = file.frame != 1
    gap = PointsFile(file.points[middle], file.frame[middle], 30.0, start_time=2.5)
    for name, scans in (("all", file), ("gap", gap)):
        paths = write_scans(tmp_path / name, scans)
        assert [path.suffix for path in paths] == [".ply"] * len(np.unique(scans.frame))
        again = read_scans(tmp_path / name, outliers=None)
        assert np.abs(again.points - scans.points).max() < 1e-6
        seconds = again.start_time + again.frame / again.fps
        assert np.allclose(seconds, 2.5 + scans.frame / 30.0, atol=1e-8)


def test_folders_that_could_not_be_read_are_not_written(body, motion, tmp_path):
    file = scan_points(motion, body, Corruption(), 0, points=5)
    one = PointsFile(file.points[:5], file.frame[:5], 30.0)
    with pytest.raises(ValueError, match="two frames"):
        write_scans(tmp_path / "one", one)
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="is a file"):
        write_scans(tmp_path / "file", file)
    write_scans(tmp_path / "scans", file)
    write_scans(tmp_path / "scans", file)
    (tmp_path / "scans" / "other.ply").touch()
    with pytest.raises(ValueError, match=r"other\.ply"):
        write_scans(tmp_path / "scans", file)
    assert not (tmp_path / "one").exists()
