"""What a table says about how it was made."""

import json
import subprocess
from argparse import Namespace
from pathlib import Path

from benchmarks.protocol import (
    Table,
    command_line,
    commit,
    recordings_source,
    tell_of,
)


def test_commands_name_their_data_and_not_the_paths_of_a_machine(tmp_path: Path) -> None:
    """Result files said no arguments at all."""
    sources = {"CORPUS": (tmp_path / "corpus", [])}
    argv = ["x.py", str(tmp_path / "corpus"), "--only", "24"]
    argv += ["--out", str(tmp_path / "tables")]
    assert command_line(argv, "benchmarks.humor", sources) == (
        "python -m benchmarks.humor CORPUS --only 24 --out tables"
    )
    assert (
        command_line(["x", "--cases", "one camera"], "m", {}) == "python -m m --cases 'one camera'"
    )


def test_the_commit_says_when_code_was_not_committed(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        named = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        subprocess.run(["git", *named, *arguments], cwd=tmp_path, check=True, capture_output=True)

    assert commit(tmp_path) is None
    git("init")
    (tmp_path / "code.py").write_text("1")
    git("add", ".")
    git("commit", "-m", "one")
    clean = commit(tmp_path)
    assert clean is not None
    assert len(clean) == 40
    (tmp_path / "untracked").write_text("2")
    assert commit(tmp_path) == clean
    (tmp_path / "code.py").write_text("2")
    assert commit(tmp_path) == clean + "+"


def test_the_checksum_is_that_of_the_files_that_were_read(tmp_path: Path) -> None:
    corpus, table = tmp_path / "corpus", Table([("x", None)], [["one"]])
    corpus.mkdir()
    (corpus / "a.npz").write_bytes(b"1")
    (corpus / "b.npz").write_bytes(b"2")

    def checksum(files: list[Path] | None) -> str:
        given = Namespace(out=tmp_path, corpus=corpus)
        tell_of(given, 0, {"r": table}, files or ())
        said = json.loads((tmp_path / "r.json").read_text())["about"][0]["data"]["CORPUS"]
        assert said["files"] == (2 if files is None else len(files))
        return said["checksum"]

    whole, one = checksum(None), checksum([corpus / "a.npz"])
    assert whole != one
    (corpus / "b.npz").write_bytes(b"3")
    assert checksum([corpus / "a.npz"]) == one
    assert checksum(None) != whole


def test_recordings_may_lie_in_files_and_in_folders(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    for name in ("one/a.c3d", "one/b.c3d", "c.mat", "d.trc"):
        (tmp_path / name).write_bytes(b"x")
    _, files = recordings_source(tmp_path, ["one", "c.mat::walk1"])["OBSERVATIONS"]
    assert sorted(file.name for file in files) == ["a.c3d", "b.c3d", "c.mat"]
    _, files = recordings_source(tmp_path)["OBSERVATIONS"]
    assert len(list(files)) == 4
