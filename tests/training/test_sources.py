"""Readers of what only trainings read: packed markers and the DeepMimic humanoid."""

import json
import lzma
from pathlib import Path

import numpy as np
import pytest

from recon.body.model import BodyModel
from recon.ingest.maps import alignments_from_rest
from training.sources import HUMANOID_MAP, read_humanoid, read_packed


def packed(path: Path, places: np.ndarray) -> Path:
    """Markers in metres, packed as differences along time of hundredths of a millimetre."""
    steps = np.diff((places * 1e5).round().reshape(len(places), -1), axis=0, prepend=0)
    path.write_bytes(lzma.compress(steps.T.astype("<i4").tobytes()))
    return path


def test_packed_markers_are_what_was_packed(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    places = 0.5 + random.random((1, 39, 3)) + np.linspace(0, 0.1, 20)[:, None, None]
    places[3:5, 7] = 0.0
    found = read_packed(packed(tmp_path / "m01_s01_e01_ok.i4.xz", places))
    assert found.fps == 100.0
    assert found.marker_names[0] == "LFHD"
    seen = found.visible
    assert not seen[3:5, 7].any()
    np.testing.assert_allclose(found.positions[seen], places[seen], atol=1e-5)  # m


def test_a_marker_that_jumps_is_not_seen_on_either_side(tmp_path: Path) -> None:
    """Some clips exchange labels for some frames; what they place there is another marker."""
    places = np.full((10, 39, 3), 0.5) + np.arange(39)[:, None] * 0.01
    places[5:, 2] += 0.3
    found = read_packed(packed(tmp_path / "a.i4.xz", places))
    assert found.visible[:, 2].tolist() == [True] * 4 + [False] * 2 + [True] * 4
    assert found.visible[:, 3].all()


def test_a_file_of_other_numbers_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.i4.xz").write_bytes(lzma.compress(b"1234" * 40))
    with pytest.raises(ValueError, match="39 packed markers"):
        read_packed(tmp_path / "a.i4.xz")


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
