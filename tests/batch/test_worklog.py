"""Logs: whole lines, repaired after a kill, held by one writer."""

import errno
import json
import os

import pytest

from recon.batch.worklog import open_log, read_log


def test_records_are_read_back_and_the_last_of_an_id_counts(tmp_path):
    path = tmp_path / "log.jsonl"
    with open_log(path) as log:
        log.append({"id": "a", "status": "bad input"})
        log.append({"id": "b", "status": "ok"})
        log.append({"id": "a", "status": "ok"})
    expected = {"a": {"id": "a", "status": "ok"}, "b": {"id": "b", "status": "ok"}}
    assert read_log(path) == expected
    with open_log(path) as log:
        assert log.records == expected


def test_what_is_known_is_not_said_twice(tmp_path):
    path = tmp_path / "log.jsonl"
    with open_log(path) as log:
        log.append({"id": "a", "status": "bad input", "seconds": 1.0})
    with open_log(path) as log:
        log.append({"id": "a", "status": "bad input", "seconds": 2.0})
        log.append({"id": "a", "status": "ok"})
    assert len(path.read_text().splitlines()) == 2


@pytest.mark.parametrize("cut", ['{"id": "b", "stat', '{"id": "b", "status": "ok"}', "\0\0\0"])
def test_a_line_cut_short_is_cut_off(cut, tmp_path):
    """The next line was appended to it, so that both were lost."""
    path = tmp_path / "log.jsonl"
    path.write_text('{"id": "a"}\n' + cut)
    assert set(read_log(path)) == {"a"}
    with open_log(path) as log:
        assert set(log.records) == {"a"}
        log.append({"id": "c"})
    assert [json.loads(line)["id"] for line in path.read_text().splitlines()] == ["a", "c"]


def test_lines_of_another_kind_are_passed_over(tmp_path):
    path = tmp_path / "log.jsonl"
    lines = ["[" * 200_000, "7", '{"status": "ok"}', '{"id": 3}', "", '{"id": "a"}', "\x00"]
    path.write_text("\n".join(lines) + "\n")
    assert set(read_log(path)) == {"a"}


def test_one_writer_at_a_time(tmp_path):
    path = tmp_path / "log.jsonl"
    with open_log(path), pytest.raises(ValueError, match="another run is writing"), open_log(path):
        pass
    with open_log(path):
        pass


def test_a_full_disk_leaves_whole_lines(tmp_path, monkeypatch):
    path = tmp_path / "log.jsonl"
    write = os.write

    def full(descriptor: int, data: bytes) -> int:
        write(descriptor, data[:5])
        raise OSError(errno.ENOSPC, "No space left on device")

    with open_log(path) as log:
        log.append({"id": "a"})
        monkeypatch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space"):
            log.append({"id": "b"})
        monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:5]))
        with pytest.raises(OSError, match="written whole"):
            log.append({"id": "b"})
    assert path.read_text() == '{"id": "a"}\n'
