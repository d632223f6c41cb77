"""Columns, points and times that a file has twice are refused or told, never dropped silently."""

from pathlib import Path

import numpy as np
import pytest

import recon
from recon.core.skeleton import JOINTS
from recon.detections.reader import read_keypoints
from recon.keypoints3d.tables import read_table
from recon.mocap.marker_tables import read_trc

PARTS = ("nose", "left_hip", "right_hip", "left_knee", "right_knee")


def table(path: Path, clock: str, times, names=PARTS) -> Path:
    """A table of points in space, with a column of times or frames."""
    head = ",".join([clock, *(f"{name}_{axis}" for name in names for axis in "xyz")])
    rows = [f"{t}" + ",0.1,0.2,0.3" * len(names) for t in times]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def test_columns_of_one_name_are_refused(tmp_path):
    """The last of them was taken."""
    with pytest.raises(recon.FormatError, match="every column once, got 2 of nose_x"):
        read_table(table(tmp_path / "a.csv", "frame", range(5), (*PARTS, "nose")))
    parts = (*PARTS, "nose")
    lines = ["scorer" + ",a,a,a" * 6, "bodyparts," + ",".join(p for p in parts for _ in "xyc")]
    lines += ["coords" + ",x,y,likelihood" * 6, *(f"{k}" + ",9,9,1" * 6 for k in range(5))]
    (tmp_path / "b.csv").write_text("\n".join(lines))
    with pytest.raises(recon.FormatError, match="every column once, got 2 of one nose x"):
        read_keypoints(tmp_path / "b.csv")


def test_joints_that_are_given_twice_are_refused():
    points = np.zeros((3, 2, 3))
    with pytest.raises(recon.ObservationError, match="each only once"):
        recon.Joints3D(points, np.ones((3, 2), bool), (4, 4), 30.0)


@pytest.mark.parametrize("frames", [[0, 1, 1, 2], [0, 2, 1, 3]])
def test_frames_that_do_not_increase_are_refused(frames, tmp_path):
    """Rows were taken in their order, whatever their frames were."""
    with pytest.raises(recon.FormatError, match="frame numbers that increase, got 1 after"):
        read_table(table(tmp_path / "a.csv", "frame", frames))


def test_frames_that_are_missing_are_unseen(tmp_path):
    """Time went on without them."""
    found = read_table(table(tmp_path / "a.csv", "frame", [7, 8, 11, 12]))
    seen = np.isfinite(found.positions).all((1, 2))
    assert seen.tolist() == [True, True, False, False, True, True]
    assert found.decisions == (
        "2 frame numbers between others are missing: these frames are taken as unseen",
    )
    stepped = read_table(table(tmp_path / "b.csv", "frame", [10, 12, 16]))
    assert np.isfinite(stepped.positions).all((1, 2)).tolist() == [True, True, False, True]
    assert "step by 2 are taken as consecutive frames" in stepped.decisions[0]


def test_frames_dropped_between_times_are_unseen(tmp_path):
    """The times determined no rate, and with a given one the gap was closed."""
    found = read_table(table(tmp_path / "a.csv", "time", [5.0, 5.033, 5.067, 5.2, 5.233]))
    seen = np.isfinite(found.positions).all((1, 2))
    assert seen.tolist() == [True, True, True, False, False, False, True, True]
    assert (round(found.fps, 1), found.start_time) == (30.0, 5.0)
    assert "between which 3 frames are missing" in found.decisions[-1]


def test_times_that_are_no_clock_are_refused_or_told(tmp_path):
    with pytest.raises(recon.FormatError, match=r"times that rise, got 0\.1 s after 0\.2 s"):
        read_table(table(tmp_path / "a.csv", "time", [0, 0.2, 0.1, 0.3]))
    found = read_table(table(tmp_path / "b.csv", "time", [0, 0.1, 0.1, 0.3]))
    assert found.fps is None
    assert "do not rise evenly" in found.decisions[-1]
    places = "".join(f"\t0\t{0.1 * k}\t0" for k in range(22))
    (tmp_path / "c.trc").write_text(
        "PathFileType\t4\t(X/Y/Z)\tc.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\t"
        "OrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n30\t30\t3\t22\tm\t30\t1\t3\nFrame#\tTime\t"
        + "\t\t\t".join(JOINTS) + "\n\t\tX1\n\n"
        + f"1\t0.5{places}\n" * 3
    )  # fmt: skip
    assert any("Time does not rise" in said for said in read_trc(tmp_path / "c.trc").decisions)


def test_rows_that_a_trc_leaves_out_are_unseen(tmp_path):
    """The mean of its times was taken as frame rate: 100 Hz became 85.7."""
    names = ["A", "B"]
    head = [
        "PathFileType\t4\t(X/Y/Z)\ta.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        "100\t100\t7\t2\tm",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
    ]
    times = [2.00, 2.01, 2.02, 2.04, 2.05, 2.06, 2.07]
    rows = [f"{k + 1}\t{t:.2f}\t0\t1.{k}\t0.1\t0.2\t1.5\t0.3" for k, t in enumerate(times)]
    (tmp_path / "a.trc").write_text("\n".join([*head, "", *rows]))
    found = read_trc(tmp_path / "a.trc")
    assert found.fps == 100
    assert found.visible[:, 0].tolist() == [True] * 3 + [False] + [True] * 4
    assert any("1 frame numbers between others are missing" in said for said in found.decisions)


def test_rows_of_several_people_are_refused(tmp_path):
    """The message spoke of frame numbers, or people alternated from row to row."""
    path = table(tmp_path / "a.csv", "Person_ID", [0, 1, 0, 1])
    with pytest.raises(
        recon.FormatError, match="column Person_ID has 0, 1: write the rows of one"
    ):
        read_table(path)
    assert len(read_table(table(tmp_path / "b.csv", "person", [4, 4, 4])).positions) == 3


def test_rows_and_numbers_that_are_no_data_are_told(tmp_path):
    """A row that was half written had wrong numbers, and a number too large was unseen."""
    path = table(tmp_path / "a.csv", "frame", range(4))
    path.write_text(path.read_text()[:-20])
    found = read_table(path)
    assert len(found.positions) == 3
    assert "the last row has 12 of 16 cells" in found.decisions[0]
    path.write_text(path.read_text().replace("0.2", "1e400"))
    with pytest.raises(recon.FormatError, match="number '1e400' in row 0 is too large"):
        read_table(path)
