"""Files that would run something, take all memory, write elsewhere, or call somebody."""

import ast
import json
import lzma
import pickle
import resource
import struct
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from tests.robust.doors import command, refused, refused_by_all, refused_by_command

ROOM = 1 << 30
"""Bytes of memory that reading a small file may take."""


class Planted:
    """What writes a file where it is unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, ...]:
        return Path.write_text, (self.target, "owned")


def _object_array(path: Path, planted: Planted) -> None:
    np.savez(path, trans=np.array([planted], dtype=object))


def _member(path: Path, planted: Planted) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("kind.npy", pickle.dumps(planted))
        archive.writestr("../../escape.npy", b"\x93NUMPY")


PICKLES: dict[str, Callable[[Path, Planted], object]] = {
    "a.npz": _object_array,
    "members.npz": _member,
    "a.npy": lambda path, planted: np.save(path, np.array([planted], dtype=object)),
    "a.pkl": lambda path, planted: path.write_bytes(pickle.dumps({"pose": planted})),
    "old.pkl": lambda path, planted: path.write_bytes(pickle.dumps({"pose": planted}, 0)),
    "a.pt": lambda path, planted: torch.save({"smpl_params_global": planted}, path),
    "a.pth": lambda path, planted: path.write_bytes(pickle.dumps(planted)),
    "a.safetensors": lambda path, planted: path.write_bytes(pickle.dumps(planted)),
    "a.json": lambda path, planted: path.write_bytes(pickle.dumps(planted)),
    "a.c3d": lambda path, planted: path.write_bytes(pickle.dumps(planted)),
}


@pytest.mark.parametrize("name", PICKLES)
@pytest.mark.filterwarnings("ignore:Detected pickle protocol:UserWarning")  # of torch
def test_nothing_planted_is_run(tmp_path: Path, seen: Path, name: str) -> None:
    target, path = tmp_path / "owned", tmp_path / name
    PICKLES[name](path, Planted(target))
    refused_by_all(path)
    refused(lambda: recon.refine(path, frame_rate=30.0), name, "plain arrays")
    for option in ("--body", "--weights"):
        refused_by_command("fit", seen, option, path, "--out", tmp_path / "m.npz", names=(name,))
    assert not target.exists()
    assert not (tmp_path.parent / "escape.npy").exists()


def _npz_that_promises(path: Path) -> None:
    """The header of an array of 10^10 rows before no numbers."""
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000, 22, 3), }"
    head = head.ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("positions", "trans", "poses", "betas"):
            data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head
            archive.writestr(f"{name}.npy", data)


def _npy_that_promises(path: Path) -> None:
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000, 17, 3), }"
    head = head.ljust(117) + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + bytes(800))


def _c3d_that_promises(path: Path) -> None:
    head = bytearray(512)
    struct.pack_into("<BBHHHH", head, 0, 2, 0x50, 65535, 65535, 1, 65535)
    path.write_bytes(bytes(head) + bytes(512))


def _png(path: Path) -> None:
    path.mkdir()
    size = struct.pack(">II", 60_000, 60_000)
    (path / "0.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + size + bytes(40))


def _scans(head: str, name: str) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        path.mkdir()
        for k in range(2):
            (path / f"{k}{name}").write_bytes(head.encode() + bytes(40))
        (path / "times.csv").write_text("0\n1\n")

    return write


_PLY = "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\n"
_PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1000000000000\n"
_BVH = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\nMOTION\n"
BOMBS: dict[str, Callable[[Path], object]] = {
    "a.npz": _npz_that_promises,
    "a.npy": _npy_that_promises,
    "a.c3d": _c3d_that_promises,
    "images": _png,
    "ply": _scans(_PLY + "property float x\nend_header\n", ".ply"),
    "pcd": _scans(_PCD + "HEIGHT 1\nPOINTS 1000000000000\nDATA binary\n", ".pcd"),
    "a.bvh": lambda path: path.write_text(_BVH + "Frames: 2000000000\nFrame Time: 0.01\n0 0 0\n"),
    "a.bvh.xz": lambda path: path.write_bytes(lzma.compress(bytes(300 << 20), preset=0)),
    "deep.json": lambda path: path.write_text('{"a":' * 100_000),
    "lists.json": lambda path: path.write_text("[" * 200_000),
    "digits.json": lambda path: path.write_text('{"frame": 1' + "0" * 100_000 + "}"),
    "a.trc": lambda path: path.write_text("PathFileType\t4\n" * 3 + "9" * 10_000),
    "a.pkl": lambda path: path.write_bytes(
        pickle.dumps({"poses": _Asking(np.ndarray, ((10**10,),))})
    ),
    "bytes.pkl": lambda path: path.write_bytes(pickle.dumps({"poses": _Asking(bytes, (10**10,))})),
}  # fmt: skip


class _Asking:
    """What asks for ten billion numbers or bytes where it is unpickled."""

    def __init__(self, *call: object) -> None:
        self.call = call

    def __reduce__(self) -> tuple[object, ...]:
        return self.call


@pytest.fixture
def little_room() -> Iterator[None]:
    """A gibibyte of memory more than is used now."""
    status = Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("this system does not tell the memory of a process")
    used = next(int(ln.split()[1]) for ln in status.read_text().splitlines() if "VmSize" in ln)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, ((used << 10) + ROOM, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.usefixtures("little_room")
def test_bombs_are_refused_before_they_unpack(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    BOMBS[name](path)
    refused_by_all(path)
    refused(lambda: recon.refine(path, frame_rate=30.0))
    if name.endswith((".bvh", ".xz", ".c3d", ".trc")):
        refused(lambda: recon.convert(path), name)
    assert not list(tmp_path.glob("*.part"))


def test_no_code_of_ours_runs_what_it_reads() -> None:
    """No `eval`, no unpickling but by a reader of our own, of torch's files tensors alone."""
    root = Path(recon.__file__).parents[1]
    bad: list[str] = []
    for folder in ("recon", "priors", "observations", "training"):
        for path in (root / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_bytes())):
                if isinstance(node, ast.Call):
                    bad += [f"{path}:{node.lineno}: {why}" for why in _risks(node)]
    assert bad == []


def _risks(call: ast.Call) -> list[str]:
    name, of = "", ""
    if isinstance(call.func, ast.Name):
        name = call.func.id
        if name in ("eval", "exec", "compile", "Unpickler", "__import__"):
            return [name]
    elif isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Name):
        name, of = call.func.attr, call.func.value.id
    given = {word.arg: getattr(word.value, "value", None) for word in call.keywords}
    if of in ("pickle", "marshal", "shelve", "joblib", "yaml", "dill") and name in (
        "load",
        "loads",
        "open",
        "Unpickler",
    ):
        return [f"{of}.{name}"]
    if of == "os" and name in ("system", "popen"):
        return [f"os.{name}"]
    if given.get("shell") is True or given.get("allow_pickle") is True:
        return ["shell or allow_pickle"]
    return (
        ["torch.load"] if (of, name) == ("torch", "load") and not given.get("weights_only") else []
    )


def test_a_fit_calls_nobody(seen: Path, tmp_path: Path) -> None:
    """No name is looked up, no connection made, no program started, by a fit and its files."""
    called: list[str] = []
    watched = ("socket.connect", "socket.getaddrinfo", "socket.sendto", "os.system",
               "subprocess.Popen", "os.exec", "os.posix_spawn", "urllib.Request")  # fmt: skip
    open_now = [True]

    def hook(event: str, _: object) -> None:
        if open_now[0] and event in watched:
            called.append(event)

    sys.addaudithook(hook)
    try:
        assert command("fit", seen, "--prior", "pose", "--out", tmp_path / "m.npz")[0] == 0
        assert command("info", tmp_path / "m.npz")[0] == 0
        refused_by_command("info", tmp_path / "m.npz.txt")
    finally:
        open_now[0] = False  # hooks cannot be taken away
    assert called == []
    assert json.loads((tmp_path / "m.npz.json").read_text())["failed"] is False
