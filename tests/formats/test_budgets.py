"""Small files that become large, deep or slow are refused within a budget, whatever reads them."""

import io
import pickle
import struct
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from recon.core.visible import visible
from recon.formats.calibration import load_cameras
from recon.formats.depth_images import read_png
from recon.formats.estimates import read_estimate
from recon.formats.json_files import read_frame_folder, read_json
from recon.formats.opening import load_arrays
from recon.formats.pickles import read_tree
from recon.formats.projects import project_at

SECONDS = 5.0
"""Of the processor: a quarter of it is usual, without a budget it takes minutes."""


def _doubled(kind, levels=40):
    """A container that holds two references to the one below, and so on: 2^levels leaves."""
    below = kind([0.0, 0.0]) if kind is list else {"a": 0.0}
    for _ in range(levels):
        below = [below, below] if kind is list else {"a": below, "b": below}
    return below


def _cycle():
    tree: dict = {}
    tree["transl"] = tree
    return tree


def _deep(levels=200):
    below: object = 0.0
    for _ in range(levels):
        below = {"a": below}
    return below


def _estimate(**arrays):
    return {"poses": np.zeros((2, 66)), "trans": np.zeros((2, 3)), **arrays}


def _deflated(path: Path, content: object) -> None:
    """As torch saves it, but compressed, so that zeros take no room."""
    plain = io.BytesIO()
    torch.save(content, plain)
    with zipfile.ZipFile(plain) as given, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for one in given.infolist():
            out.writestr(one.filename, given.read(one))


PICKLES = {
    "shared dictionaries": lambda: _doubled(dict),
    "shared lists": lambda: {"poses": _doubled(list), "trans": np.zeros((2, 3))},
    "a cycle": _cycle,
    "200 levels": _deep,
    "a wide shared list": lambda: {"a": [[0.0] * 100_000] * 100_000},
    "lists in lists in tuples": lambda: {"a": (_doubled(list),)},
}


@pytest.mark.parametrize("name", PICKLES)
def test_pickled_trees_are_bounded(name, tmp_path):
    path = tmp_path / "bomb.pkl"
    path.write_bytes(pickle.dumps(PICKLES[name](), protocol=2))
    began = time.process_time()
    with pytest.raises(ValueError, match="bomb"):
        read_tree(path)
    assert time.process_time() - began < SECONDS


TENSORS = {
    "repeated zeros": lambda: _estimate(poses=torch.zeros(1).expand(3_000_000_000, 66)),
    "shared dictionaries": lambda: _doubled(dict),
    "shared lists": lambda: {"poses": _doubled(list)},
}


@pytest.mark.parametrize("name", TENSORS)
def test_tensors_are_bounded(name, tmp_path):
    path = tmp_path / "bomb.pt"
    torch.save({key: torch.as_tensor(v) if isinstance(v, np.ndarray) else v
                for key, v in TENSORS[name]().items()}, path)  # fmt: skip
    began = time.process_time()
    with pytest.raises(ValueError, match="expected"):
        read_estimate(path)
    assert time.process_time() - began < SECONDS


def test_compressed_tensors_are_refused_before_they_unpack(tmp_path):
    path = tmp_path / "bomb.pt"
    _deflated(path, {"poses": torch.zeros(1000, 66), "trans": torch.zeros(1000, 3)})
    with pytest.raises(ValueError, match="is compressed"):
        read_estimate(path)


def test_numbers_count_as_what_they_become(tmp_path):
    """Bytes of zeros took a hundredth of the memory that doubles of them did."""
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            head, {"descr": "|i1", "fortran_order": False, "shape": (300_000_000,)}
        )
        with archive.open("poses.npy", "w", force_zip64=True) as member:
            member.write(head.getvalue())
            for _ in range(300):
                member.write(bytes(1_000_000))
    began = time.process_time()
    with pytest.raises(ValueError, match="size of the unpacked arrays"):
        load_arrays(path)
    assert time.process_time() - began < SECONDS
    frames = tmp_path / "frames.npz"
    np.savez(frames, frame_ids=np.array([0, 9_999_998]), **_estimate())
    with pytest.raises(ValueError, match="frame_ids"):
        read_estimate(frames)


CALIBRATIONS = {
    "dotted.toml": ".".join(["a"] * 60_000) + " = 1\n",
    "quoted.toml": ".".join(['"a"'] * 20_000) + " = 1\n",
    "header.toml": "[" + ".".join(["a"] * 60_000) + "]\n",
    "spaced.toml": " . ".join(["a"] * 30_000) + " = 1\n",
    "brackets.toml": "a = " + "[" * 100_000 + "\n",
    "long.toml": "a" * 900_000 + "\n",
    "matrices.yml": "%YAML:1.0\n"
    + "K_a: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [\n" * 5000,
    "colons.yml": ":" * 900_000,
    "keys.yml": "a:\n" * 250_000,
    "dashes.yml": "a:\n" + "- \n" * 250_000 + "b",
    "brackets.json": "[" * 900_000,
    "braces.json": '{"a":' * 100_000,
    "digits.json": "9" * 100_000,
    "lists.json": "[" + "[]," * 5_000_000 + "0]",
    "dictionaries.json": "[" + '{"a":1},' * 2_000_000 + "0]",
}


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_text_is_read_in_linear_time(name, tmp_path):
    path = tmp_path / name
    path.write_text(CALIBRATIONS[name])
    began = time.process_time()
    with pytest.raises(ValueError, match=name.partition(".")[0]):
        read_json(path) if path.suffix == ".json" else load_cameras(path)
    assert time.process_time() - began < SECONDS


def test_frames_in_many_files_are_bounded_together(tmp_path):
    for k in range(3):
        (tmp_path / f"{k}.json").write_text("[" + "[]," * 2_000_000 + "0]")
    began = time.process_time()
    with pytest.raises(ValueError, match="number of entries in JSON"):
        read_frame_folder(tmp_path)
    assert time.process_time() - began < SECONDS


@pytest.mark.parametrize(("bits", "colour"), [(16, 6), (8, 2), (16, 0)])
def test_images_are_bounded_by_what_they_unpack_to(bits, colour, tmp_path):
    """An image of 8000 x 8000 pixels of 16 bits in four channels took 18 s and 1.3 GB."""
    size = struct.pack(">IIBB", 9000, 9000, bits, colour)
    (tmp_path / "0.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + size + bytes(40))
    with pytest.raises(ValueError, match="size of an unpacked image"):
        read_png(tmp_path / "0.png")


TWICE = {
    "twice.yml": "camera_matrix: 1\ncamera_matrix: 2\n",
    "names.yml": "names:\n  - a\n  - a\nK_a: 1\n",
}


@pytest.mark.parametrize("name", TWICE)
def test_cameras_that_are_said_twice_are_refused(name, tmp_path):
    """The first was taken in silence."""
    (tmp_path / name).write_text(TWICE[name])
    with pytest.raises(ValueError, match="once"):
        load_cameras(tmp_path / name)
    (tmp_path / "folder").mkdir()
    for suffix in (".yml", ".yaml"):
        (tmp_path / "folder" / f"a{suffix}").write_text(
            "M: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ 1. ]\n"
        )
    with pytest.raises(ValueError, match="different names of cameras"):
        load_cameras(tmp_path / "folder")


def test_pipes_are_not_opened(tmp_path):
    import os

    (tmp_path / "pose").mkdir()
    (tmp_path / "videos").mkdir()
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "Calib.toml").write_text("")
    (tmp_path / "Config.toml").write_text("[project]\nframe_rate = 'auto'\n")
    os.mkfifo(tmp_path / "videos" / "a.mp4")
    project_at(tmp_path)


NAMES = (
    "\x1b]0;title\x07", "\x1b[2J", "\u202eevil", "\x00", "\r overwritten", "\x9b31m", "\u2028",
    "\ud800", "\u200b", "\x7f",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_control_characters_are_shown(name):
    shown = visible(f"a{name}b")
    assert shown.isprintable()
    assert shown.isascii()
    assert shown[0] == "a"
    assert shown[-1] == "b"
