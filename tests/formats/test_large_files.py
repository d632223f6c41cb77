"""Small files that ask for much: time and memory stay in proportion, or they are refused."""

import time
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from recon.formats.texts import parsed_numbers
from recon.mocap.reader import read_recording
from recon.mocap.recording import head_to_foot_length
from tests.formats.test_markers import make_markers, write_c3d


def chain(joints: int) -> str:
    """A BVH whose joints hang from each other; only the root moves."""
    lines = [
        "HIERARCHY",
        "ROOT head",
        "{",
        "OFFSET 0 0 0",
        "CHANNELS 3 Xposition Yposition Zposition",
    ]
    for joint in range(1, joints - 1):
        lines += [f"JOINT j{joint}", "{", f"OFFSET 0 {-1.7 / (joints - 1)} 0", "CHANNELS 0"]
    lines += ["JOINT foot", "{", f"OFFSET 0 {-1.7 / (joints - 1)} 0", "CHANNELS 0"]
    lines += ["}"] * joints + ["MOTION", "Frames: 2", "Frame Time: 0.01", "0 1.7 0", "0 1.7 0", ""]
    return "\n".join(lines)


def slow_head_to_foot(
    parents: list[int], offsets: np.ndarray, heads: list[int], feet: list[int]
) -> float:
    """Every path between two joints, by walking up from both."""

    def way_up(joint: int) -> list[int]:
        return [joint] if parents[joint] < 0 else [*way_up(parents[joint]), joint]

    def path(one: int, two: int) -> float:
        apart = set(way_up(one)) ^ set(way_up(two))
        return float(sum(np.linalg.norm(offsets[joint]) for joint in apart))

    return max(path(one, two) for one, two in product(heads, feet))


@pytest.mark.parametrize("seed", range(20))
def test_the_longest_path_is_that_of_all_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints = int(rng.integers(1, 12))
    parents = [-1, *(int(rng.integers(0, k)) for k in range(1, joints))]
    offsets = rng.standard_normal((joints, 3))
    kinds = rng.integers(0, 4, joints)
    names = [("spine", "head", "foot", "head_foot")[kind] + str(k) for k, kind in enumerate(kinds)]
    heads = [k for k, name in enumerate(names) if "head" in name] or list(range(joints))
    feet = [k for k, name in enumerate(names) if "foot" in name] or list(range(joints))
    expected = slow_head_to_foot(parents, offsets, heads, feet)
    assert head_to_foot_length(names, parents, offsets) == pytest.approx(expected, abs=1e-12)


def test_skeletons_of_many_joints(tmp_path: Path) -> None:
    """3,000 joints and two frames took more than 15 s: every pair of joints was compared."""
    (tmp_path / "clip.bvh").write_text(chain(3000))
    start = time.process_time()
    recording = read_recording(tmp_path / "clip.bvh")
    assert time.process_time() - start < 10
    assert recording.positions.shape == (2, 3000, 3)


def test_skeletons_of_too_many_joints(tmp_path: Path) -> None:
    """20,000 joints without channels, 652 KB, took 9.9 GB before they were refused."""
    (tmp_path / "clip.bvh").write_text(chain(20_000))
    with pytest.raises(ValueError, match=r"clip\.bvh.*number of joints.*5001"):
        read_recording(tmp_path / "clip.bvh")


def test_frames_that_are_not_there_take_no_memory(tmp_path: Path) -> None:
    text = chain(10)
    (tmp_path / "clip.bvh").write_text(text.replace("Frames: 2", "Frames: 2000000"))
    with pytest.raises(ValueError, match=r"clip\.bvh.*number of frames times joints"):
        read_recording(tmp_path / "clip.bvh")


def test_numbers_are_read_in_pieces() -> None:
    rng = np.random.default_rng(0)
    values = rng.standard_normal(200_000)
    text = " \n".join(map(repr, values.tolist()))
    assert len(text) > 3 << 20
    assert np.array_equal(parsed_numbers(text, len(values)), values)
    assert np.array_equal(parsed_numbers("x 1 2 3", 3, 1), [1, 2, 3])
    assert np.array_equal(parsed_numbers(b"1 2 3 ", 3), [1, 2, 3])
    for bad, count in (("1 2", 3), ("1 2 3 4", 3), ("1 b 2", 3), ("9" * 3_000_000, 2)):
        with pytest.raises(ValueError, match=r"number|convert"):
            parsed_numbers(bad, count)


def test_points_with_a_negative_residual_are_not_seen(tmp_path: Path) -> None:
    """C3D marks a lost point by residual -1 and may leave its last place; no test noticed."""
    markers = make_markers()
    write_c3d(tmp_path / "clip.c3d", markers)
    data = bytearray((tmp_path / "clip.c3d").read_bytes())
    place = markers.positions[3, 0].astype(np.float64) * 1000
    row = place.astype("<f4").tobytes()
    at = bytes(data).index(row)
    data[at + 12 : at + 16] = np.array(-1.0, "<f4").tobytes()
    (tmp_path / "clip.c3d").write_bytes(data)
    back = read_recording(tmp_path / "clip.c3d")
    assert not back.visible[3, 0]  # type: ignore[union-attr]
    assert not back.positions[3, 0].any()
    assert back.visible.sum() == markers.visible.sum() - 1  # type: ignore[union-attr]
