"""Observation files of the benchmark of clouds."""

from benchmarks.cloud_cases import Seen, write_files
from recon.formats.observations import PositionsFile, load_observation
from tests.filmed import bundled, walk


def test_joints_are_written_as_they_are_read(tmp_path):
    """Frames were taken for a leading axis of clips, and one of them alone was written."""
    truth = walk(6)
    (path,) = write_files(Seen(truth, bundled(), 0), "joints", tmp_path)
    file = load_observation(path)
    assert isinstance(file, PositionsFile)
    assert file.positions.shape == (6, 22, 3)
    assert file.truth_visible is None
