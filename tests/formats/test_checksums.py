"""Content hashes: what they depend on, what they do not, and that they are streamed."""

import hashlib
import os
import tracemalloc

import pytest

from recon.formats.replacing import file_checksum, files_checksum, value_checksum


def test_a_file_is_its_bytes_and_not_its_place(tmp_path):
    (tmp_path / "a").write_bytes(b"one")
    (tmp_path / "b").write_bytes(b"one")
    assert file_checksum(tmp_path / "a") == hashlib.sha256(b"one").hexdigest()
    assert file_checksum(tmp_path / "a") == file_checksum(tmp_path / "b")
    with pytest.raises(FileNotFoundError):
        file_checksum(tmp_path / "c")


def test_a_pipe_is_refused_and_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="expected a file, got a folder, pipe or device"):
        file_checksum(tmp_path / "pipe")


def test_files_of_a_folder_are_contents_and_relative_names(tmp_path):
    def made(folder: str, **contents: str) -> str:
        for name, text in contents.items():
            (tmp_path / folder).mkdir(exist_ok=True)
            (tmp_path / folder / name).write_text(text)
        files = [tmp_path / folder / name for name in contents]
        return files_checksum(reversed(files), tmp_path / folder)

    first = made("first", a="1", b="2")
    assert made("elsewhere", a="1", b="2") == first  # the order and the place do not count
    assert made("changed", a="1", b="3") != first
    assert made("renamed", a="1", c="2") != first
    assert made("exchanged", a="2", b="1") != first
    assert files_checksum([tmp_path / "first" / "none"], tmp_path / "first") != first


def test_large_files_are_streamed(tmp_path):
    """A folder with videos of 9 GB was read whole, which ended in MemoryError."""
    with (tmp_path / "video.mp4").open("wb") as file:
        file.truncate(1 << 27)  # sparse
    tracemalloc.start()
    file_checksum(tmp_path / "video.mp4")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 22  # bytes


def test_values_have_no_order_of_keys():
    assert value_checksum({"a": 1, "b": [2, None]}) == value_checksum({"b": [2, None], "a": 1})
    assert value_checksum({"a": 1}) != value_checksum({"a": 2})
    assert value_checksum(["ab", "c"]) != value_checksum(["a", "bc"])
