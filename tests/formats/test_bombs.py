"""Small files that become large, of all readers: each takes little time and little memory.

Every file is looked at by `recon info` in a process of its own, whose processor time and memory
count from where it begins.
"""

import contextlib
import io
import lzma
import os
import pickle
import resource
import struct
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from recon.view.info import info
from tests.formats.test_budgets import CALIBRATIONS, PICKLES, TENSORS

SECONDS, MEGABYTES = 4.0, 500.0
"""Twice the time that they take at most on a processor that nobody else uses."""

BVH = (
    b"HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation "
    b"Xrotation Yrotation\n%bEnd Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: %d\n"
    b"Frame Time: 0.1\n0 0 0 0 0 0\n"
)
JOINT = b"JOINT b\n{\nOFFSET 0 0 0\nCHANNELS 0\n"
TRC = (
    b"PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\t"
    b"OrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n100\t100\t%d\t%d\tm\t100\t1\t1\n"
)
PLY = b"ply\nformat %b 1.0\nelement vertex %d\n%bend_header\n"
PCD = (
    b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 %d\nWIDTH %d\nHEIGHT 1\n"
    b"POINTS %d\nDATA %b\n"
)
AXES = b"property float x\nproperty float y\nproperty float z\n"
ASF = (
    b":version 1.10\n:units\nmass 1\nlength 1\nangle deg\n:root\norder TX TY TZ RX RY RZ\n"
    b"axis XYZ\nposition 0 0 0\norientation 0 0 0\n:bonedata\n"
)


def _npz(kind: str, shape: tuple[int, ...], size: int, members: int = 0) -> bytes:
    """An archive of one array of zeros, and of so many empty members."""
    head, out = io.BytesIO(), io.BytesIO()
    described = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, described)
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("poses.npy", "w", force_zip64=True) as member:
            member.write(head.getvalue())
            for _ in range(size >> 20):
                member.write(bytes(1 << 20))
        for k in range(members):
            archive.writestr(f"{k}.npy", b"")
    return out.getvalue()


def _c3d() -> bytes:
    head = bytearray(1024)
    struct.pack_into("<BBHHHHHfH", head, 0, 2, 80, 65535, 0, 1, 65535, 0, -1.0, 3)
    head[512:516] = bytes((1, 80, 1, 84))
    return bytes(head)


def _mat(content: bytes) -> bytes:
    packed = zlib.compress(content, 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    return head + struct.pack("<II", 15, len(packed)) + packed


def _torch(content: object) -> bytes:
    out = io.BytesIO()
    torch.save(content, out)
    return out.getvalue()


def _tar(name: str, data: bytes) -> bytes:
    """An archive of one file."""
    member, out = tarfile.TarInfo(name), io.BytesIO()
    member.size = len(data)
    with tarfile.open(fileobj=out, mode="w") as archive:
        archive.addfile(member, io.BytesIO(data))
    return out.getvalue()


BOMBS: dict[str, Callable[[], bytes]] = {
    **{f"{k}.pkl": lambda k=k: pickle.dumps(PICKLES[k](), protocol=2) for k in PICKLES},
    **{f"{k}.pt": lambda k=k: _torch(TENSORS[k]()) for k in TENSORS},
    **{k: lambda k=k: CALIBRATIONS[k].encode() for k in CALIBRATIONS},
    "deep.bvh": lambda: BVH % (JOINT * 100_000, 1),
    "wide.bvh": lambda: BVH % ((JOINT + b"}\n") * 100_000, 1),
    "frames.bvh": lambda: BVH % (b"", 2_000_000_000),
    "newlines.bvh": lambda: b"HIERARCHY" + b"\n" * 1_000_000,
    "newlines.tar.xz": lambda: lzma.compress(_tar("a.bvh", b"\n" * 200_000_000), preset=0),
    "line.bvh": lambda: BVH.split(b"0 0 0")[0] + b"0 " * 4_000_000,
    "promise.trc": lambda: TRC % (10**12, 10**9) + b"Frame#\tTime\ta\n\t\tX1\n1\t0\t1\n",
    "wide.trc": lambda: TRC % (1, 10**6) + b"Frame#\tTime" + b"\ta\t\t" * 10**6 + b"\n\n1\t0\n",
    "tabs.trc": lambda: b"\t" * 30_000_000,
    "zeros.trc.xz": lambda: lzma.compress(b"\t" * 200_000_000, preset=0),
    "bones.asf": lambda: ASF + b"begin\nname b\ndirection 0 0 1\nlength 1\nend\n" * 50_000,
    "rows.csv": lambda: b"frame,a_x,a_y,a_z\n" + b"0,1,2,3\n" * 5_000_000,
    "wide.csv": lambda: b"frame" + b",a_x" * 900_000 + b"\n0" + b",1" * 900_000,
    "quotes.csv": lambda: b'"' * 10_000_000,
    "sparse.csv": lambda: b"frame,nose_x,nose_y,nose_z\n0,1,2,3\n9999998,1,2,3\n",
    "bytes.npz": lambda: _npz("|i1", (300 << 20,), 300 << 20),
    "floats.npz": lambda: _npz("<f8", (60 << 20,), 480 << 20),
    "promise.npz": lambda: _npz("<f8", (10**12, 66), 1 << 20),
    "text.npz": lambda: _npz("<U78643200", (1,), 300 << 20),
    "members.npz": lambda: _npz("<f8", (1 << 17,), 1 << 20, members=5000),
    "promise.c3d": _c3d,
    "promise.ply": lambda: PLY % (b"binary_little_endian", 10**12, AXES) + bytes(40),
    "words.ply": lambda: PLY % (b"ascii", 10**6, AXES) + b"1 " * 10_000_000,
    "columns.ply": lambda: PLY % (b"ascii", 1, b"property float x\n" * 400_000) + b"1\n",
    "promise.pcd": lambda: PCD % (1, 10**12, 10**12, b"binary") + bytes(40),
    "count.pcd": lambda: PCD % (10**9, 10, 10, b"binary") + bytes(40),
    "packed.pcd": lambda: PCD % (1, 1 << 27, 1 << 27, b"binary_compressed")
    + struct.pack("<II", 4, 3 << 29) + bytes(4),
    "zeros.mat": lambda: _mat(struct.pack("<II", 14, 1 << 30) + bytes(200_000_000)),
    "zeros.pkl": lambda: zlib.compress(b"\x80\x02" + bytes(300_000_000), 1),
    "nulls.json": lambda: b"[" + b"null," * 10_000_000 + b"{}]",
    "numbers.json": lambda: b"[" + b"1e5," * 15_000_000 + b"0]",
    "letters.json": lambda: '["😀'.encode() + b"a" * 60_000_000 + b'"]',
}  # fmt: skip


FAULTS = ("too slow", "too large", "neither read nor refused")


def _used(path: Path) -> int:
    """The number of what is wrong with looking at a file in this process, or 0."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    with contextlib.suppress(ValueError, FileNotFoundError):
        info(path)
    used = resource.getrusage(resource.RUSAGE_SELF)
    large = used.ru_maxrss / 1e3 - pages * resource.getpagesize() / 1e6 > MEGABYTES
    return 1 if used.ru_utime + used.ru_stime > SECONDS else 2 * large


@pytest.mark.skipif(sys.platform != "linux", reason="counts pages of Linux's processes")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_takes_little(name, tmp_path):
    path = tmp_path / name
    path.write_bytes(BOMBS[name]())
    child = os.fork()
    if child == 0:
        try:
            os._exit(_used(path))
        finally:
            os._exit(len(FAULTS))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code == 0, FAULTS[code - 1] if code > 0 else f"signal {-code}"
