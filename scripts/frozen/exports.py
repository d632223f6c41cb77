"""Runs `recon export`, and reads its files as numbers and the words between them."""

import json
import re
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

_ENDINGS = {
    "--usd": "usda",
    "--robot": "npz",
    "--smpl": "npz",
    "--angles": "csv",
    "--joints": "csv",
}
Arrays = dict[str, np.ndarray]
"""Arrays: `joints` in m, `objective` of the last stage, `words`, other numbers by name."""

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")


def exported(*options: str) -> Callable[[Path], Arrays]:
    """Make a case that runs `recon export` and reads numbers and words of its file."""

    def case(inputs: Path) -> Arrays:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / f"motion.{_ENDINGS.get(options[0], options[0][2:])}"
            words = [str(inputs / w) if w == "SMPLX_NEUTRAL.npz" else w for w in options[1:]]
            export(inputs / "clip.npz", options[0], target, *words)
            return _read(target)

    return case


def _read(path: Path) -> Arrays:
    if path.is_dir():
        files = sorted(one for one in path.iterdir() if one.suffix == ".ply")
        numbers = [np.frombuffer(p.read_bytes().split(b"end_header\n", 1)[1][:12000], "<f4")
                   for p in files[::10]]  # fmt: skip
        return {"words": np.array([one.name for one in files]), "numbers": np.stack(numbers)}
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {key: file[key] for key in file.files if file[key].dtype.kind in "fiub"}
    data = path.read_bytes()
    if path.suffix == ".glb":
        size = struct.unpack("<I", data[12:16])[0]
        return _text(data[20 : 20 + size].decode()) | _buffers(data, 20 + size)
    return _text(data.decode())


def _buffers(data: bytes, first: int) -> Arrays:
    """Read the numbers of a binary glTF: its accessors of floats, one after the other."""
    about, binary = json.loads(data[20:first]), data[first + 8 :]
    found = []
    for one in about["accessors"]:
        if one["componentType"] == 5126:
            view = about["bufferViews"][one["bufferView"]]
            start = view.get("byteOffset", 0) + one.get("byteOffset", 0)
            size = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[one["type"]]
            found.append(np.frombuffer(binary, "<f4", one["count"] * size, start))
    return {"buffer": np.concatenate(found)}


def _text(text: str) -> Arrays:
    """Split a text into numbers and words, without names of programs and their versions."""
    text = re.sub(r"(recon|torch|numpy|motion-recon)[ \"':v]*\d+(\.\d+)+\S*", "", text)
    numbers = np.array([float(number) for number in _NUMBER.findall(text)])
    return {"words": np.array(_NUMBER.sub("#", text).splitlines()), "numbers": numbers}


def export(*words: str | Path) -> None:
    recon_command("export", *words)


def recon_command(*words: str | Path) -> None:
    command = [sys.executable, "-m", "recon", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd="/")
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr}")
