"""Damaged files: every reader says what it expected, and raises nothing but ValueError."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from recon.core.errors import ReconError
from recon.formats.motions import load_motion, save_motion
from recon.formats.observations import load_observation, save_observation
from recon.formats.scans import read_ply, write_ply
from recon.mocap.marker_tables import write_trc
from recon.mocap.reader import read_recording
from tests.formats.test_bvh import AMC, ASF, BVH
from tests.formats.test_markers import make_markers, write_c3d
from tests.formats.test_npz import POSITIONS, make_file

READERS: dict[str, Callable[[Path], object]] = {
    ".npz": load_motion,
    ".obs.npz": load_observation,
    ".ply": read_ply,
}
SUFFIXES = (".bvh", ".amc", ".c3d", ".trc", ".mat", ".npz", ".obs.npz", ".ply")


def make_good(path: Path, suffix: str) -> bytes:
    if suffix == ".bvh":
        path.write_text(BVH)
    elif suffix == ".amc":
        path.write_text(AMC)
    elif suffix == ".c3d":
        write_c3d(path, make_markers())
    elif suffix == ".trc":
        write_trc(path, make_markers())
    elif suffix == ".npz":
        save_motion(path, make_file())
    elif suffix == ".obs.npz":
        save_observation(path, POSITIONS)
    elif suffix == ".ply":
        write_ply(path, np.eye(3), np.array([[0, 1, 2]]))
    else:
        from scipy.io import savemat

        data = make_markers().positions.reshape(5, -1)
        names = np.array(["LFHD", "C7", "RKNE", "LHEE"], dtype=object)
        savemat(path, {"walk": {"data": data, "markerName": names, "freq": 100}})
    return path.read_bytes()


def read(path: Path, suffix: str) -> None:
    """Read, allowing for success: a change may be harmless."""
    problem: ValueError | None = None
    try:
        READERS.get(suffix, read_recording)(path)
    except ValueError as error:
        problem = error
    if problem is not None:
        assert isinstance(problem, ReconError), repr(problem)
        assert path.name.split("_")[0] in str(problem), problem
        assert len(str(problem)) < 1000


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "clip.asf").write_text(ASF)
    return tmp_path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_empty_missing_and_folder(place: Path, suffix: str) -> None:
    path = place / f"clip_1{suffix}"
    reader = READERS.get(suffix, read_recording)
    with pytest.raises(FileNotFoundError, match="clip_1"):
        reader(path)
    path.touch()
    with pytest.raises(ValueError, match="empty"):
        reader(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(ValueError, match="directory"):
        reader(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_cut_short(place: Path, suffix: str) -> None:
    path = place / f"clip_1{suffix}"
    good = make_good(path, suffix)
    READERS.get(suffix, lambda p: read_recording(p, up="y"))(path)
    stride = 20 if suffix == ".mat" else 1  # each takes a process of its own
    for length in sorted({*range(1, 40), *np.linspace(1, len(good) - 1, 40).astype(int).tolist()})[
        ::stride
    ]:
        path.write_bytes(good[:length])
        read(path, suffix)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_noise_and_flipped_bytes(place: Path, suffix: str) -> None:
    path = place / f"clip_1{suffix}"
    good = np.frombuffer(make_good(path, suffix), dtype=np.uint8)
    rng = np.random.default_rng(7)
    for size in (1, 7, 600, 5000):
        path.write_bytes(rng.integers(0, 256, size, dtype=np.uint8).tobytes())
        with pytest.raises(ValueError, match="clip_1"):
            READERS.get(suffix, read_recording)(path)
    for _ in range(3 if suffix == ".mat" else 40):
        changed = good.copy()
        where = rng.integers(0, len(good), 4)
        changed[where] = rng.integers(0, 256, 4, dtype=np.uint8)
        path.write_bytes(changed.tobytes())
        read(path, suffix)


@pytest.mark.parametrize("name", ["a.bvh.xz", "a.tar.xz", "a.tar", "a.fbx", "a", "a.npz", "a.amc"])
def test_unknown_or_wrongly_packed(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\xfd7zXZ\x00 this is no archive")
    (tmp_path / "a.asf").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="a"):
        read_recording(tmp_path / name)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Frames: 2", "Frames: 3"),
        ("Frames: 2", "Frames: -1"),
        ("Frames: 2", "Frames: many"),
        ("0.0333333", "0"),
        ("0.0333333", "nan"),
        ("1 95 3", "1 95 nan"),
        ("1 95 3", "1 95 inf"),
        ("OFFSET 0 60 0", "OFFSET 0 60"),
        ("OFFSET 0 60 0", "OFFSET 0 inf 0"),
        ("OFFSET 0 60 0", ""),
        ("CHANNELS 3", "CHANNELS 4"),
        ("Xposition Y", "Xposition X"),
        ("JOINT Head", "JOINT Hips"),
        ("JOINT Head", "ROOT Head"),
        ("JOINT Head", "BONE Head"),
        ("} }", "}"),
        ("MOTION", ""),
    ],
)
def test_bvh_errors_are_found(tmp_path: Path, old: str, new: str) -> None:
    assert old in BVH
    (tmp_path / "clip.bvh").write_text(BVH.replace(old, new))
    with pytest.raises(ValueError, match=r"clip\.bvh"):
        read_recording(tmp_path / "clip.bvh", up="y")
