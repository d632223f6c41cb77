"""Whole folders of recordings: names that no two share, work that is redone when it has to be."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import pytest

from recon.batch.collection import clips_by_collection, contents_of_clips, recordings_left_out
from recon.batch.corpus import convert_corpus
from recon.batch.worklog import read_log
from recon.benchmark.dataset import Splits, clip_files
from recon.cli import FAILED, OK, run
from tests.batch.corpus_jobs import unknown, write_clip

ROOT = Path(__file__).parents[2]


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    return folder


def names_of(folder: Path) -> list[str]:
    return [clip.name for clips in clips_by_collection(folder) for clip in clips]


def test_names_are_paths_without_the_ending(tmp_path):
    """They ended at the first dot, and folders were joined by signs that names have, too: of
    subj.1/walk and subj.1/run, walk.v1 and walk.v2, a/walk and a_walk one was written over."""
    files = ("subj.1/walk.bvh", "subj.1/run.bvh", "walk.v1.bvh", "walk.v2.BVH", "a/walk.bvh",
             "a_walk.bvh", "b/walk.bvh.xz", "b/walk.1.amc")  # fmt: skip
    touched(tmp_path / "in", *files)
    assert sorted(names_of(tmp_path / "in")) == sorted(
        [
            "subj.1/walk",
            "subj.1/run",
            "walk.v1",
            "walk.v2",
            "a/walk",
            "a_walk",
            "b/walk",
            "b/walk.1",
        ]
    )


def test_names_in_a_manifest_are_as_it_says_or_paths(tmp_path):
    """Folders of a manifest's paths were dropped: s1/walk and s2/walk were one."""
    (tmp_path / "manifest.csv").write_text("path\ns1/walk.bvh\ns2/walk.bvh\n")
    assert names_of(tmp_path) == ["s1/walk", "s2/walk"]
    (tmp_path / "manifest.csv").write_text("\ufeffpath,clip\ns1/walk.bvh,one\ns2/walk.bvh,two\n")
    assert names_of(tmp_path) == ["one", "two"]
    (tmp_path / "manifest.csv").write_text("path,clip\ns1/walk.bvh,\ns2/walk.bvh,s2/walk\n")
    assert names_of(tmp_path) == ["walk", "s2/walk"]
    (tmp_path / "manifest.csv").write_text("path,clip\ns1/walk.bvh,\ns2/walk.bvh,\n")
    with pytest.raises(ValueError, match=r"rename one of them \(or its clip in the manifest\)"):
        names_of(tmp_path)


def test_names_of_the_recordings_here_are_what_splits_know(data):
    """recon/benchmark/splits.toml and trained weights know clips by these names."""
    for clips in clips_by_collection(data / "mocap"):
        with (data / "mocap" / clips[0].collection / "manifest.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        former = {row["clip"] if "archive" in row else Path(row["path"]).name.split(".")[0]
                  for row in rows if "archive" in row or ".asf" not in row["path"]}  # fmt: skip
        assert {clip.name for clip in clips} == former


@pytest.mark.parametrize(
    "files",
    [("walk.bvh", "walk.amc"), ("walk.bvh", "walk.bvh.xz"), ("Walk.bvh", "walk.bvh"),
     ("s/walk.bvh", "S/walk.amc")],
)  # fmt: skip
def test_recordings_that_would_be_one_output_are_refused(files, tmp_path):
    touched(tmp_path / "in", *files)
    with pytest.raises(ValueError, match=r"would both be written as in/.*rename one"):
        clips_by_collection(tmp_path / "in")


def test_recordings_that_are_no_skeletons_are_told(tmp_path, caplog):
    """The help promised that markers are converted; they were left out in silence."""
    names = ("a.bvh", "s/walk.c3d", "T.TRC", "all.tar.xz", "notes.txt", "table.csv")
    touched(tmp_path / "in", *names)
    rows = convert_corpus(tmp_path / "in", tmp_path / "out", processes=1, calibration=unknown)
    said = {str(row["clip"]): row for row in rows}
    assert set(said) == {"a", "s/walk.c3d", "T.TRC", "all.tar.xz"}
    assert said["s/walk.c3d"]["status"] == "rejected"
    assert "recon batch" in str(said["T.TRC"]["reason"])
    assert "manifest.csv" in str(said["all.tar.xz"]["reason"])
    assert json.loads((tmp_path / "out" / "report.json").read_text())[0]["clip"] == "T.TRC"
    assert "3 recordings were left out" in caplog.text
    (tmp_path / "in" / "manifest.csv").write_text("path\na.bvh\n")
    touched(tmp_path / "in", "b.bvh")
    found = clips_by_collection(tmp_path / "in")
    left = {clip.name: why for clip, why in recordings_left_out(tmp_path / "in", found)}
    assert "no row of" in left["b.bvh"]
    (tmp_path / "in" / "manifest.csv").unlink()
    with pytest.raises(ValueError, match="markers are converted one by one"):
        clips_by_collection(tmp_path / "in" / "s")


def test_a_collection_beside_one_of_the_same_name_is_refused_where_clips_meet(tmp_path):
    root = tmp_path / "x"
    touched(root, "a.bvh", "x/a.bvh")
    (root / "manifest.csv").write_text("path\na.bvh\n")
    (root / "x" / "manifest.csv").write_text("path\na.bvh\n")
    with pytest.raises(ValueError, match=r"would both be written as x/a\.npz"):
        clips_by_collection(root)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("path,clip\na.bvh,../../a\n", "line 2: expected a name of the clip that can be a path"),
        ("path\n../a.bvh\n", "line 2: expected a name of the clip"),
        ("path,clip\na.bvh,/etc/a\n", "line 2: expected a name of the clip"),
        ("archive,clip\na.tar,\n", "line 2: expected the name of a clip of a.tar"),
        ("path,clip\n,a\n", "line 2: expected a path"),
        ("name\na\n", "line 2: expected a path"),
        ("path\n" + "a" * 200_000 + ".bvh\n", "expected a table in CSV"),
    ],
)
def test_manifests_are_checked_line_by_line(text, words, tmp_path):
    (tmp_path / "manifest.csv").write_text(text)
    with pytest.raises(ValueError, match=words):
        clips_by_collection(tmp_path)


def test_members_of_archives_are_told_apart(tmp_path):
    touched(tmp_path, "s1/walk.bvh", "s2/walk.bvh", "s1/run.bvh")
    with tarfile.open(tmp_path / "all.tar", "w") as archive:
        for name in ("s1/walk.bvh", "s2/walk.bvh", "s1/run.bvh"):
            archive.add(tmp_path / name, name)
    manifest = tmp_path / "manifest.csv"
    manifest.write_text(
        "archive,clip\n" + "".join(f"all.tar,{n}\n" for n in ("s1/walk", "s2/walk", "run"))
    )
    (clips,) = clips_by_collection(tmp_path)
    assert {c.clip.name: c.text for c in contents_of_clips(clips)} == {
        "s1/walk": "s1/walk.bvh", "s2/walk": "s2/walk.bvh", "run": "s1/run.bvh",
    }  # fmt: skip
    manifest.write_text("archive,clip\nall.tar,walk\n")
    ((clip,),) = clips_by_collection(tmp_path)
    assert (
        "several recordings 'walk', one of them s2/walk.bvh"
        in list(contents_of_clips([clip]))[-1].missing
    )


@pytest.mark.slow
def test_work_is_keyed_by_contents_and_one_clip_stops_no_other(tmp_path):
    """Work was keyed by settings alone, and one recording could keep its subject from it all."""
    source, out = tmp_path / "in", tmp_path / "out"
    for name, subject in (("a", 0), ("b", 0), ("poison", 0), ("c", 2), ("poison2", -3)):
        write_clip(source / f"{name}.bvh", subject, 30)

    def logged() -> dict[str, dict]:
        convert_corpus(source, out, processes=1, calibration=unknown)
        return {name.removeprefix("in/"): row for name, row in read_log(out / "log.jsonl").items()}

    first = logged()
    reasons = {name: row["rows"][0]["reason"] for name, row in first.items()}
    assert {reasons[name] for name in ("a", "b", "poison")} == {"calibrated from a, b"}
    assert reasons["c"] == "calibrated from c"
    assert "could not be found: OverflowError: poison" in reasons["poison2"]
    assert first["poison2"]["status"] == "error"
    assert "Traceback" in first["poison2"]["traceback"]
    write_clip(source / "b.bvh", 0, 31)
    again = logged()
    assert {name for name in first if first[name] != again[name]} == {"a", "b", "poison"}


@pytest.mark.slow
def test_a_changed_recording_redoes_its_subject_and_no_other(tmp_path, capsys):
    """Work was keyed by settings alone: recordings that changed kept their old motions."""
    source, out = tmp_path / "in", tmp_path / "out"
    for name, subject, start in (("anna/walk", 2, 30), ("anna/run", 2, 60), ("ben/walk", -2, 30)):
        write_clip(source / f"{name}.bvh", subject, start)
    touched(source, "bad.bvh")
    arguments = ["convert", "--all", str(source), str(out), "--processes", "1", "--json"]
    assert run(arguments) == FAILED
    told = json.loads(capsys.readouterr().out)
    assert (told["converted"], told["rejected"], told["failed"]) == (3, 0, 1)
    (source / "bad.bvh").unlink()
    log = read_log(out / "log.jsonl")
    assert {name: row["status"] for name, row in log.items()} == {
        "in/anna/walk": "ok", "in/anna/run": "ok", "in/ben/walk": "ok", "in/bad": "bad input",
    }  # fmt: skip
    files = clip_files(out)
    assert set(files) == {"anna/walk", "anna/run", "ben/walk"}
    assert Splits.load().subject("anna/walk") == "anna"

    def times() -> dict[str, int]:
        return {name: path.stat().st_mtime_ns for name, path in files.items()}

    before, lines = times(), (out / "log.jsonl").read_bytes()
    assert run(arguments) == OK
    assert times() == before
    assert (out / "log.jsonl").read_bytes() == lines
    write_clip(source / "ben" / "walk.bvh", -2, 45)
    (out / "in" / "anna" / "run.npz").write_bytes(b"somebody's own")
    assert run(arguments) == FAILED
    rows = {row["clip"]: row for row in json.loads((out / "report.json").read_text())}
    assert rows["anna/run"]["status"] == "bad input"
    assert "recon did not write it" in rows["anna/run"]["reason"]
    assert (out / "in" / "anna" / "run.npz").read_bytes() == b"somebody's own"
    after = times()
    assert after["anna/walk"] == before["anna/walk"]
    assert after["ben/walk"] > before["ben/walk"]


def run_killed(source: Path, out: Path, seconds: float | None) -> int:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.batch.corpus_jobs", str(source), str(out)]
    process = subprocess.Popen(command, env=environment, cwd=ROOT)
    if seconds is None:
        return process.wait()
    before = len(read_log(out / "log.jsonl"))
    deadline = time.monotonic() + 900
    while process.poll() is None and len(read_log(out / "log.jsonl")) < before + 4:
        time.sleep(0.02)
        assert time.monotonic() < deadline
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    return process.wait()


@pytest.mark.slow
def test_200_recordings_killed_20_times(tmp_path):
    """Ten of them are bad; the motions are those of an uninterrupted run, bit for bit."""
    source, out, plain = tmp_path / "in", tmp_path / "out", tmp_path / "plain"
    for k in range(190):
        write_clip(source / f"s{k % 5}" / f"clip{k}.bvh", k % 5 - 2, k % 80)
    good = (source / "s0" / "clip0.bvh").read_text()
    bad = {
        "text": "nothing",
        "empty": "",
        "binary": "\0" * 1000,
        "deep": "{" * 200_000,
        "cut": good[: len(good) // 2],
        "short": "\n".join(good.splitlines()[:-3]),
        "nan": good.replace("0.", "nan", 50),
        "negative": good.replace("Frames: 31", "Frames: -31"),
        "rate": good.replace("Frame Time: 0", "Frame Time: x"),
        "joints": good.replace("JOINT", "JIONT"),
    }
    for name, text in bad.items():
        (source / f"{name}.bvh").write_text(text)
    draw = random.Random(0)
    for _ in range(20):
        run_killed(source, out, draw.uniform(0.0, 2.0))
    assert run_killed(source, out, None) == 0
    assert run_killed(source, plain, None) == 0
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert len(lines) == len({line["id"] for line in lines}) == 200
    assert sum(line["status"] == "ok" for line in lines) == 190
    ours = sorted(path.relative_to(out) for path in out.rglob("*.npz"))
    assert len(ours) == 190
    assert ours == sorted(path.relative_to(plain) for path in plain.rglob("*.npz"))
    for path in ours:
        assert (out / path).read_bytes() == (plain / path).read_bytes(), path
