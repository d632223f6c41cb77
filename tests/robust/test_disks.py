"""Disks that are full, places that vanish or are somebody's, links in circles, odd names."""

import contextlib
import os
import resource
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import recon
from tests.robust.doors import (
    DONE,
    FAILED,
    REFUSED,
    command,
    files_below,
    refused,
    refused_by_command,
    started,
)


@contextlib.contextmanager
def room_for(size: int) -> Iterator[None]:
    """No file can grow beyond so many bytes, as if the disk were full then."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


WRITERS = {
    "fit": ("fit", "seen.npz", "--prior", "pose", "--out", "out/m.npz"),
    "simulate": ("simulate", "motion.npz", "out/seen.npz", "--kind", "markers3d"),
    "views": ("simulate", "motion.npz", "out/v", "--kind", "keypoints2d", "--views", "2"),
    "evaluate": ("evaluate", "motion.npz", "motion.npz", "--json", "out/m.json"),
    "export": ("export", "motion.npz", "--bvh", "out/m.bvh", "--glb", "out/m.glb"),
}
"""Commands that write, in a folder with a motion and an observation."""


@pytest.fixture
def place(seen: Path, whole: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copy(whole / "motion.npz", seen.parent / "motion.npz")
    monkeypatch.chdir(seen.parent)
    return seen.parent


@pytest.mark.parametrize("verb", WRITERS)
def test_a_full_disk_leaves_what_was_there(place: Path, verb: str) -> None:
    before = files_below(place)
    with room_for(200):
        refused_by_command(*WRITERS[verb])
    assert files_below(place) == before


@pytest.mark.parametrize("verb", ["simulate", "evaluate", "export"])
def test_files_of_others_are_not_written_over(place: Path, verb: str) -> None:
    out = next(word for word in reversed(WRITERS[verb]) if word.startswith("out/"))
    (place / "out").mkdir()
    (place / out).write_text("mine")
    said = refused_by_command(*WRITERS[verb], names=(Path(out).name,))
    assert "--overwrite" in said
    assert files_below(place / "out") == {Path(out).name}
    assert (place / out).read_text() == "mine"
    assert command(*WRITERS[verb], "--overwrite")[0] == DONE
    assert command(*WRITERS[verb])[0] == DONE  # its own by now


def test_a_result_is_saved_where_its_folder_vanished(place: Path) -> None:
    result = recon.fit(place / "seen.npz", "pose")
    (place / "out").mkdir()
    (place / "out").rmdir()
    result.save(place / "out" / "m.npz")
    assert recon.load_motion(place / "out" / "m.npz").motion.frames == 12
    (place / "file").write_text("mine")
    refused(lambda: result.save(place / "file" / "m.npz"), "file")
    assert (place / "file").read_text() == "mine"


def test_a_batch_whose_folder_vanishes_ends_in_words(place: Path) -> None:
    (place / "clips.jsonl").write_text('{"id": "a", "observations": "seen.npz"}\n')
    process = started("batch", "clips.jsonl", "--out", "out", "--prior", "pose")
    while process.poll() is None and not (place / "out").exists():
        time.sleep(0.002)
    shutil.rmtree(place / "out", ignore_errors=True)
    _, said = process.communicate()
    assert process.returncode in (DONE, FAILED, REFUSED)
    assert "Traceback" not in said
    if process.returncode == DONE:
        assert (place / "out" / "a.npz").is_file()


def test_links_in_circles_are_refused(place: Path) -> None:
    for name, to in (("a.npz", "b.npz"), ("b.npz", "a.npz")):
        (place / name).symlink_to(to)
    (place / "folder").mkdir()
    (place / "folder" / "again").symlink_to(place / "folder")
    refused(lambda: recon.load_observation(place / "a.npz"), "a.npz")
    refused(lambda: recon.load_motion(place / "a.npz"), "a.npz")
    for words in (("info", "a.npz"), ("fit", "a.npz", "--out", "m.npz")):
        refused_by_command(*words, names=("a.npz",))
    for words in (("info", "folder"), ("fit", "folder", "--out", "m.npz"),
                  ("convert", "folder", "motions", "--all")):  # fmt: skip
        refused_by_command(*words, names=("folder",))


@pytest.mark.parametrize(
    "name",
    ["a\nb.npz", "-x.npz", "[red]a[bold].npz", "$(touch run).npz", "' \".npz", "Ü☃.npz",
     "a" * 200 + ".npz", "%s{0}.npz", ".npz.npz", b"\xff\xfe.npz"],
    ids=ascii,
)  # fmt: skip
def test_odd_names_are_names(place: Path, name: str | bytes) -> None:
    path = place / os.fsdecode(name)
    shutil.copy(place / "seen.npz", path)
    seen = recon.load_observation(path)
    assert isinstance(seen, recon.Joints3D)
    code, answer, said = command("info", path)
    assert code == DONE, said
    assert answer
    recon.simulate(place / "motion.npz", "joints3d", frames=(0, 4)).save(path, overwrite=True)
    assert recon.load_observation(path).positions.shape == (1, 4, 22, 3)  # type: ignore[union-attr]
    path.write_bytes(b"nothing")
    refused(lambda: recon.load_observation(path))
    refused_by_command("info", path)
    assert files_below(place) <= {"seen.npz", "motion.npz", path.name, f"{path.name}.json"}


def test_outputs_are_no_devices(place: Path) -> None:
    refused_by_command("simulate", "motion.npz", "/dev/full", "--kind", "joints3d")
    refused_by_command("simulate", "motion.npz", "/dev/null", "--kind", "joints3d")
    assert np.load(place / "seen.npz")["positions"].shape == (12, 22, 3)
