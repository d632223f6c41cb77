"""Files are replaced in one step; nothing is left of runs that were killed."""

import os
import subprocess
import sys

import numpy as np
import pytest

from recon.formats.replacing import clear_leftovers, replacing, save_arrays, temporary_path


@pytest.fixture(scope="module")
def dead() -> int:
    """Number of a process that has ended."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")

    def interrupted() -> None:
        with replacing(path) as beside:
            beside.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path):
    """The link itself was replaced, and what it led to kept the old contents."""
    real, link = tmp_path / "real", tmp_path / "link"
    real.write_text("old")
    link.symlink_to(real)
    with replacing(link) as beside:
        beside.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_leftovers_of_dead_processes_go_and_others_stay(tmp_path, dead):
    """What a killed run had half written stayed for ever."""
    path = tmp_path / "m.npz"
    mine = temporary_path(path)
    ours = str(os.getpid())
    names = [
        mine.name.replace(f"-{ours}.", f"-{os.getppid()}."),
        mine.name.replace("m.npz", "other.npz").replace(f"-{ours}.", f"-{dead}."),
        mine.name.replace(f"-{ours}.", f"elsewhere-{dead}."),
        mine.name.replace(f"-{ours}.", "-notes."),
    ]
    for name in names:
        (tmp_path / name).write_text("kept")
    (tmp_path / mine.name.replace(f"-{ours}.", f"-{dead}.")).write_text("gone")
    clear_leftovers(path)
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted(names)


def test_writing_a_motion_clears_what_a_killed_run_left(tmp_path, dead):
    path = tmp_path / "m.npz"
    left = temporary_path(path).name.replace(f"-{os.getpid()}.", f"-{dead}.")
    (tmp_path / left).mkdir()
    (tmp_path / left / "m.npz").write_text("half")
    save_arrays(path, {"a": np.zeros(3)})
    assert list(tmp_path.iterdir()) == [path]
