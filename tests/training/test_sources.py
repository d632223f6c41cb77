"""Readers of what only trainings read: packed markers and the DeepMimic humanoid."""

import json
import lzma
import tomllib
from pathlib import Path

import numpy as np
import pytest

from recon.batch.collection import SourceClip
from recon.body.model import BodyModel
from recon.ingest.maps import alignments_from_rest
from training.sources import (
    HUMANOID_MAP,
    read_cmu_windows,
    read_humanoid,
    read_packed_markers,
)


def packed(path: Path, places: np.ndarray) -> Path:
    """Markers in metres, packed as differences along time of hundredths of a millimetre."""
    steps = np.diff((places * 1e5).round().reshape(len(places), -1), axis=0, prepend=0)
    path.write_bytes(lzma.compress(steps.T.astype("<i4").tobytes()))
    return path


def test_packed_markers_are_what_was_packed(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    places = 0.5 + random.random((1, 39, 3)) + np.linspace(0, 0.1, 20)[:, None, None]
    places[3:5, 7] = 0.0
    found = read_packed_markers(packed(tmp_path / "m01_s01_e01_ok.i4.xz", places))
    assert found.fps == 100.0
    assert found.marker_names[0] == "LFHD"
    seen = found.visible
    assert not seen[3:5, 7].any()
    np.testing.assert_allclose(found.positions[seen], places[seen], atol=1e-5)  # m


def test_a_marker_that_jumps_is_not_seen_on_either_side(tmp_path: Path) -> None:
    """Some clips exchange labels for some frames; what they place there is another marker."""
    places = np.full((10, 39, 3), 0.5) + np.arange(39)[:, None] * 0.01
    places[5:, 2] += 0.3
    found = read_packed_markers(packed(tmp_path / "a.i4.xz", places))
    assert found.visible[:, 2].tolist() == [True] * 4 + [False] * 2 + [True] * 4
    assert found.visible[:, 3].all()


def test_a_file_of_other_numbers_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.i4.xz").write_bytes(lzma.compress(b"1234" * 40))
    with pytest.raises(ValueError, match="39 packed markers"):
        read_packed_markers(tmp_path / "a.i4.xz")


def still(count: int = 2) -> np.ndarray:
    """Frames of the humanoid at zero rotations, its root a metre high."""
    frame = np.zeros(44)
    frame[0], frame[2] = 1 / 30, 1.0
    frame[[4, 8, 12, 16, 21, 25, 30, 35, 39]] = 1.0
    return np.tile(frame, (count, 1))


def test_the_humanoid_hangs_its_arms_and_rests_in_a_t_pose(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"Frames": still().tolist()}))
    found = read_humanoid(path)
    assert found.fps == 30.0
    wrist, shoulder = (found.positions[0, found.joint(f"left_{n}")] for n in ("wrist", "shoulder"))
    np.testing.assert_allclose(wrist - shoulder, (0.0, 0.0, -0.533735), atol=1e-6)  # m, z up
    assert alignments_from_rest(found, HUMANOID_MAP, BodyModel.load()) is not None


def test_hinges_of_the_humanoid_bend_knees_back_and_elbows_ahead(tmp_path: Path) -> None:
    frames = still()
    frames[:, 20], frames[:, 29] = -1.0, 1.0  # right knee, right elbow
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"Frames": frames.tolist()}))
    found = read_humanoid(path)
    ahead = found.orientations[0, 0] @ np.array([1.0, 0.0, 0.0])
    places = {name: found.positions[0, found.joint(name)] for name in found.joint_names}
    assert (places["right_ankle"] - places["right_knee"]) @ ahead < -0.3  # m
    assert (places["right_wrist"] - places["right_elbow"]) @ ahead > 0.2  # m


def test_other_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"Frames": [[1, 2, 3]]}')
    with pytest.raises(ValueError, match="44 numbers"):
        read_humanoid(tmp_path / "a.json")


def windows(folder: Path, collar: float) -> list[SourceClip]:
    """A window of somebody whose collars point up by so many degrees, on a skeleton of CMU."""
    table = tomllib.loads(BONES)
    lines, order = ["HIERARCHY"], []

    def write(name: str, depth: int) -> None:
        order.append(name)
        offset = " ".join(str(10 * x) for x in table[name]["offset"])
        lines.append(f"{'ROOT' if depth == 0 else 'JOINT'} {name} {{ OFFSET {offset}")
        lines.append(f"CHANNELS {'6 Xposition Yposition Zposition' if depth == 0 else '3'} "
                     "Zrotation Xrotation Yrotation")  # fmt: skip
        below = [child for child, row in table.items() if row.get("parent") == name]
        for child in below:
            write(child, depth + 1)
        lines.append("}" if below else "End Site { OFFSET 0 1 0 } }")

    write("Hips", 0)
    turns = {"LeftShoulder": collar, "RightShoulder": -collar}
    frame = [0.0, 100.0, 0.0] + [x for name in order for x in (turns.get(name, 0.0), 0.0, 0.0)]
    numbers = " ".join(map(str, frame))
    lines += ["MOTION", "Frames: 3", "Frame Time: 0.0083333", *[numbers] * 3]
    path = folder / "39_01_w1.bvh"
    path.write_text("\n".join(lines) + "\n")
    return [SourceClip("cmu_windows", "39_01_w1", path)]


BONES = """
Hips = {offset = [0, 0, 0]}
LeftUpLeg = {parent = "Hips", offset = [1, -1, 0]}
LeftLeg = {parent = "LeftUpLeg", offset = [0, -4, 0]}
LeftFoot = {parent = "LeftLeg", offset = [0, -4, 0]}
RightUpLeg = {parent = "Hips", offset = [-1, -1, 0]}
RightLeg = {parent = "RightUpLeg", offset = [0, -4, 0]}
RightFoot = {parent = "RightLeg", offset = [0, -4, 0]}
Spine1 = {parent = "Hips", offset = [0, 2, 0]}
Neck = {parent = "Spine1", offset = [0, 2, 0]}
Neck1 = {parent = "Neck", offset = [0, 1, 0]}
Head = {parent = "Neck1", offset = [0, 1, 0.274]}
LeftShoulder = {parent = "Spine1", offset = [0, 2, 0]}
LeftArm = {parent = "LeftShoulder", offset = [1.902, 0.598, -0.16]}
LeftForeArm = {parent = "LeftArm", offset = [3, 0, 0]}
RightShoulder = {parent = "Spine1", offset = [0, 2, 0]}
RightArm = {parent = "RightShoulder", offset = [-1.902, 0.598, -0.16]}
RightForeArm = {parent = "RightArm", offset = [-3, 0, 0]}
"""


@pytest.mark.parametrize(("collar", "left"), [(0.0, 0.0), (8.0, 8.0), (20.0, 0.0)])
def test_shoulders_drawn_up_by_a_foreign_skeleton_come_down(
    tmp_path: Path, collar: float, left: float
) -> None:
    """Collars of CMU 39 and 118 pointed up by 14 degrees more than those of others."""
    found = read_cmu_windows(windows(tmp_path, collar))["39_01_w1"]
    shoulder, arm, hand = (found.joint(f"Left{n}") for n in ("Shoulder", "Arm", "ForeArm"))
    bone = found.positions[1, arm] - found.positions[1, shoulder]
    usual = np.degrees(np.arctan2(0.299, 0.951))
    # metres, z up; the body faces -y, so that its left is x
    up = np.degrees(np.arctan2(bone[2], np.hypot(bone[0], 0.0)))
    assert up == pytest.approx(usual + left, abs=1.0)
    upper_arm = found.positions[1, hand] - found.positions[1, arm]
    length = np.linalg.norm(upper_arm)
    raised = np.degrees(np.arcsin(upper_arm[2] / length))
    assert raised == pytest.approx(collar, abs=0.1), "arms keep their orientations"
