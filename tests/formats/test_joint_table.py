"""Tables of joints, and what a motion file says of its certainty in a line."""

import csv
from dataclasses import replace

import pytest
import torch

import recon
from recon import cli
from recon.api.result import motion_file_of
from recon.core.skeleton import JOINTS
from recon.formats.joint_table import JointCertainty
from recon.formats.motions import save_motion
from recon.keypoints3d.reader import read_points_3d
from recon.view.info import info
from tests.filmed import bundled, walk

FRAMES = 6


def fitted():
    """A motion whose ankles nobody saw; pelvises are known to 1 cm, all other joints to 3 cm."""
    std = torch.full((FRAMES, 22), 0.03)
    std[:, 0] = 0.01
    observed = torch.ones(FRAMES, 22, dtype=torch.bool)
    observed[:, [7, 8]] = False
    return motion_file_of(walk(FRAMES), bundled(), observed=observed, joint_std=std)


def rows_of(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_table_has_positions_deviations_and_what_was_seen(tmp_path):
    file, source, table = fitted(), tmp_path / "m.npz", tmp_path / "m.csv"
    save_motion(source, file)
    assert cli.run(["export", str(source), "--joints", str(table)]) == cli.OK
    rows = rows_of(table)
    assert len(rows) == FRAMES
    assert len(rows[0]) == 2 + 22 * 6
    assert file.joints is not None
    for k, row in enumerate(rows):
        assert float(row["time"]) == pytest.approx(k / 30, abs=1e-6)
        there = [float(row[f"left_knee_{axis}"]) for axis in "xyz"]
        assert there == pytest.approx(file.joints[k, JOINTS.index("left_knee")].tolist(), abs=1e-4)
        assert (row["pelvis_std"], row["left_knee_std"]) == ("0.01", "0.03")
        assert (row["pelvis_observed"], row["left_ankle_observed"]) == ("1", "0")
        assert float(row["left_foot_contact"]) in (0.0, 1.0)
    assert (tmp_path / "m.csv.json").is_file()


def test_what_a_motion_does_not_know_has_no_columns(tmp_path):
    save_motion(tmp_path / "m.npz", walk(FRAMES))
    assert (
        cli.run(["export", str(tmp_path / "m.npz"), "--joints", str(tmp_path / "m.csv")]) == cli.OK
    )
    assert len(rows_of(tmp_path / "m.csv")[0]) == 2 + 22 * 3


def test_a_table_is_read_again_as_keypoints(tmp_path):
    """Its further columns are not taken for coordinates."""
    file = fitted()
    save_motion(tmp_path / "m.npz", file)
    assert (
        cli.run(["export", str(tmp_path / "m.npz"), "--joints", str(tmp_path / "m.csv")]) == cli.OK
    )
    found = read_points_3d(tmp_path / "m.csv")
    assert found.names == JOINTS
    assert found.fps == pytest.approx(30.0)
    assert file.joints is not None
    assert torch.allclose(torch.from_numpy(found.positions).float(), file.joints, atol=1e-4)


def test_a_line_tells_seen_joints_from_inferred_ones(tmp_path):
    found = JointCertainty.of(fitted())
    assert str(found) == "3.0 cm where seen, 3.0 cm where inferred (9 % of the joints)"
    assert JointCertainty.of(replace(fitted(), joint_std=None)) is None
    save_motion(tmp_path / "m.npz", fitted())
    facts = info(tmp_path / "m.npz")
    assert facts["format"] == "motion (AMASS .npz)"  # its joints were taken for 3D keypoints
    assert facts["median_joint_std_seen"] == pytest.approx(0.03)
    assert facts["share_of_hidden_joints"] == pytest.approx(2 / 22)
    save_motion(tmp_path / "bare.npz", walk(FRAMES))
    assert info(tmp_path / "bare.npz")["has_joint_std"] is False


def test_a_result_saves_its_table_and_prints_how_sure_it_is(tmp_path):
    joints = bundled().pose(walk(FRAMES)).joints
    result = recon.fit(recon.Joints3D(joints, torch.ones(FRAMES, 22), range(22), fps=30.0), "pose")
    result.save_table(tmp_path / "joints.csv")
    rows = rows_of(tmp_path / "joints.csv")
    assert result.joint_std is not None
    assert float(rows[2]["head_std"]) == pytest.approx(
        float(result.joint_std[2, JOINTS.index("head")]), rel=1e-4
    )
    assert f"standard deviation of a joint: {result.certainty}" in repr(result)
    assert result.report()["standard_deviations"]["hidden_share"] == 0
