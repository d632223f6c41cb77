"""Observation files of the benchmark of clouds."""

from benchmarks.clouds import Seen, SeenWalk, view_of, write_files
from recon.formats.observations import PointsFile, PositionsFile, load_observation
from tests.filmed import bundled, walk


def test_joints_are_written_as_they_are_read(tmp_path):
    """Frames were taken for a leading axis of clips, and one of them alone was written."""
    truth = walk(6)
    (path,) = write_files(Seen(truth, bundled(), 0), "joints", tmp_path)
    file = load_observation(path)
    assert isinstance(file, PositionsFile)
    assert file.positions.shape == (6, 22, 3)
    assert file.truth_visible is None


def test_a_walk_is_seen_from_where_it_is_said(tmp_path):
    truth = walk(6)
    for number, angle in enumerate((0.0, 90.0, 180.0)):
        # the second person, of two, is seen with the ground
        seen = SeenWalk(truth, bundled(), 4 * number, 3.0, angle)
        (path,) = write_files(seen, "walks", tmp_path)
        file = load_observation(path)
        assert isinstance(file, PointsFile)
        assert ((file.points[:, 2] < 0.02).mean() > 0.3) == (number == 1)
        pelvis = bundled().pose(truth).joints[:, 0]
        eye = seen.camera.T_world_camera[:3, 3]
        away = (pelvis - eye)[:, :2].norm(dim=-1)
        assert abs(float(away[0] + away[-1]) / 2 - 3.0) < 0.05
        nearer = float(away[0] - away[-1]) / float((pelvis[0] - pelvis[-1])[:2].norm())
        assert abs(nearer - (1.0, 0.0, -1.0)[number]) < 0.1


def test_people_are_seen_from_all_sides():
    assert len({view_of(k) for k in range(4)}) == len({view_of(4 * k) for k in range(4)}) == 4
