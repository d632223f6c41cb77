"""Damaged files: every reader reads them to finite numbers, or refuses them in words."""

import csv
import io
import json
import lzma
import re
import zipfile
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from tests.robust.doors import DONE, REFUSED, command, finite, reading

EXTREMES = (
    b"1e300", b"-1e300", b"nan", b"inf", b"0", b"-1", b"1e-320", b"", b"1e20", b"4294967296",
    b"1" + b"0" * 29, b"9" * 5000, b"0x10", b"65536", b"true", b"[]", b"1e9999", b"\xff\xfe",
)  # fmt: skip
"""What stands where a number was."""
VALUES = (1e300, -1e300, np.nan, np.inf, -np.inf, -1.0, 1e-300, 1e20, 1e6, 0.0, 70_000.0, -2e5)
WORDS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1_000_000, 0x7FC00000)
KINDS = ("complex128", "U8", "S3", "int8", "float16", "bool", "datetime64[s]")
H36M = (0, 2, 5, 8, 1, 4, 7, 3, 9, 12, 15, 16, 18, 20, 17, 19, 21)
"""Our joints that lie near the 17 points of Human3.6M."""
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def flipped(data: bytes, random: np.random.Generator) -> bytes:
    """Some bits are the other way."""
    out = bytearray(data)
    for place in random.integers(0, len(out), int(random.integers(1, 9))):
        out[place] ^= 1 << int(random.integers(0, 8))
    return bytes(out)


def cut(data: bytes, random: np.random.Generator) -> bytes:
    """The end, or a part, is missing, or comes many times."""
    first, last = sorted(int(n) for n in random.integers(0, len(data) + 1, 2))
    last = min(last, first + 4096)
    part = data[first:last] * int(random.choice([0, 0, 2, 50]))
    return data[:first] + (part + data[last:] if random.random() < 0.7 else b"")


def word(data: bytes, random: np.random.Generator) -> bytes:
    """Two or four bytes, often of the header, are an extreme number."""
    size, end = int(random.choice([2, 4])), int(random.choice([600, len(data)]))
    place = int(random.integers(0, max(min(end, len(data)) - size, 1))) & ~1
    value = int(random.choice(WORDS)) & ((1 << 8 * size) - 1)
    return data[:place] + value.to_bytes(size, "little") + data[place + size :]


def digits(data: bytes, random: np.random.Generator) -> bytes:
    """A number in the text, often of the header, is an extreme one."""
    end = min(len(data), 1500) if random.random() < 0.4 else len(data)
    found = NUMBER.search(data, int(random.integers(0, end))) or NUMBER.search(data)
    if found is None:
        return word(data, random)
    other = EXTREMES[int(random.integers(0, len(EXTREMES)))]
    return data[: found.start()] + other + data[found.end() :]


def nested(data: bytes, random: np.random.Generator) -> bytes:
    """Brackets are opened many times."""
    place = int(random.integers(0, len(data)))
    bracket = (b"[", b"{", b'{"a":', b"JOINT a\n{\n")[int(random.integers(0, 4))]
    return data[:place] + bracket * int(random.choice([2, 1000, 50_000])) + data[place:]


def lines(data: bytes, random: np.random.Generator) -> bytes:
    """A line is missing, or stands at another place as well."""
    rows = data.splitlines(keepends=True)
    a, b = (int(n) for n in random.integers(0, len(rows), 2))
    return b"".join([*rows[:a], *rows[a + 1 :]] if a < b else [*rows[:a], rows[b], *rows[a:]])


def array(data: bytes, random: np.random.Generator) -> bytes:
    """One array of an .npz file has an extreme number, another type or shape, or is missing."""
    if not zipfile.is_zipfile(io.BytesIO(data)):
        return digits(data, random)
    arrays = dict(np.load(io.BytesIO(data)))
    name = sorted(arrays)[int(random.integers(0, len(arrays)))]
    value, way = arrays.pop(name), int(random.integers(0, 8))
    with np.errstate(all="ignore"):
        if way < 4 and value.dtype.kind in "fiu" and value.size:
            value = value.copy()
            extreme = np.array(random.choice(VALUES)).astype(value.dtype)
            value.reshape(-1)[int(random.integers(0, value.size))] = extreme
        elif way == 4 and value.dtype.kind in "fiub":
            value = value.astype(KINDS[int(random.integers(0, len(KINDS)))])
        elif way == 5:
            value = value.reshape(-1)[: int(random.integers(0, max(value.size, 1)))]
        elif way == 6:
            value = np.repeat(value[None], int(random.choice([1, 2, 3])), 0)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays, **({} if way == 7 else {name: value}))
    return buffer.getvalue()


DAMAGES = (flipped, cut, word, digits, nested, lines, array, array)


class Seeds(dict[str, bytes]):
    """Contents of whole files by name."""

    def __repr__(self) -> str:
        return f"Seeds({', '.join(self)})"


@pytest.fixture(scope="module")
def seeds(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Seeds:
    """Contents of one whole file of every format, by name; of folders one file is damaged."""
    found = {path.name: path.read_bytes() for path in whole.iterdir() if path.suffix != ".json"
             and path.is_file()}  # fmt: skip
    found |= {f"scans/{p.name}": p.read_bytes() for p in sorted((whole / "scans").iterdir())[:3]}
    found["walk.bvh.xz"] = lzma.compress(found["walk.bvh"], preset=0)
    joints = np.load(whole / "joints3d.npz")["positions"][:, H36M]
    place = tmp_path_factory.mktemp("seeds") / "h36m.npy"
    np.save(place, joints)
    found["h36m.npy"] = place.read_bytes()
    pixels = np.concatenate((joints[..., ::2] * 100 + 400, joints[..., :1] * 0 + 1), -1)
    rows = [{"image_id": f"{k}.jpg", "category_id": 1, "keypoints": one.ravel().tolist(),
             "score": 1.0} for k, one in enumerate(pixels)]  # fmt: skip
    found["alphapose.json"] = json.dumps(rows).encode()
    people = {"people": [{"pose_keypoints_2d": np.ones(75).tolist()}]}
    found["a_000000000001_keypoints.json"] = json.dumps(people).encode()
    text = io.StringIO()
    csv.writer(text).writerows([["frame", "nose_x", "nose_y", "nose_z"], [0, 0.1, 0.2, 1.5]])
    found["points.csv"] = text.getvalue().encode()
    return Seeds(found)


@pytest.mark.filterwarnings("ignore")
@hypothesis.settings(
    max_examples=250, derandomize=True, deadline=None, database=None,
    suppress_health_check=list(hypothesis.HealthCheck),
)  # fmt: skip
@hypothesis.given(
    st.integers(0, 10**6), st.integers(0, 10**6), st.lists(st.sampled_from(DAMAGES), min_size=1,
    max_size=3),
)  # fmt: skip
def test_damaged_files_are_read_or_refused(seeds, tmp_path, which, seed, damages) -> None:
    name = sorted(seeds)[which % len(seeds)]
    data, random = seeds[name], np.random.default_rng(seed)
    for damage in sorted(damages, key=lambda one: one is not array):  # of arrays that are whole
        data = damage(data, random) or data
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    asked = path.parent if name.startswith("scans/") else path
    for found in reading(asked).values():
        assert isinstance(found, str) or finite(found)
    if seed % 4 == 0:
        code, _, said = command("info", asked)
        assert code in (DONE, REFUSED), said
        assert "Traceback" not in said


def test_whole_files_are_read(seeds: Seeds, tmp_path: Path) -> None:
    """Else the damage would be refused for another reason."""
    for name in ("motion.npz", "joints3d.npz", "keypoints2d.npz", "depth.npz", "walk.c3d",
                 "walk.trc", "h36m.npy"):  # fmt: skip
        (tmp_path / name).write_bytes(seeds[name])
        found = reading(tmp_path / name)
        assert any(not isinstance(one, str) for one in found.values()), found
    for name in ("walk.bvh", "walk.bvh.xz"):
        (tmp_path / name).write_bytes(seeds[name])
        assert command("info", tmp_path / name)[0] == DONE
