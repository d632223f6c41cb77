"""Jobs in processes: whatever one does, it is told of that one, and the others go on."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from recon.batch.workers import Failure, run_jobs
from tests.batch.batch_jobs import WAYS


def act(name: str) -> str:
    """Go wrong in a way, or tell one's process."""
    if name in WAYS:
        WAYS[name][0]()
    return str(os.getpid())


def hold_threads() -> str:
    import torch

    return f"{torch.get_num_threads()}"


def mark(path: str) -> None:
    time.sleep(1.0)
    Path(path).write_text("done")


@pytest.mark.slow
def test_ten_ways_to_fail_stop_nobody():
    """Only ValueError and OSError were caught: any other error ended the batch for ever."""
    jobs = [(name,) for way in WAYS for name in ("good", way, "good")]
    found = list(run_jobs(act, jobs, 2))
    assert sorted(job for job, _ in found) == sorted(jobs)
    for (name,), result in found:
        if name == "good":
            assert result.isdigit()
        else:
            assert isinstance(result, Failure)
            assert result.kind == WAYS[name][1], name
            assert bool(result.traceback) == (result.kind == "error"), name
    reasons = {name: result.reason for (name,), result in found if name != "good"}
    assert reasons["refuse"] == "expected metres, got parsecs"
    assert "SIGKILL" in reasons["be_killed"]
    assert "short of memory" in reasons["be_killed"]
    assert "SIGABRT" in reasons["abort"]
    assert reasons["leave"] == "its process ended with exit code 3"
    assert reasons["odd"] == "Odd: leftright"
    assert "OverflowError" in reasons["overflow"]
    assert "/nowhere/at/all" in reasons["miss"]


def test_processes_are_used_again_until_one_fails_for_memory():
    found = [result for _, result in run_jobs(act, [("a",), ("b",), ("exhaust",), ("c",)], 1)]
    assert found[0] == found[1] != found[3]


def test_a_process_has_one_thread():
    assert [result for _, result in run_jobs(hold_threads, [()], 1)] == ["1"]


def test_no_process_is_refused():
    with pytest.raises(ValueError, match="at least one process, got 0"):
        list(run_jobs(act, [], 0))


def test_whoever_stops_listening_stops_the_work(tmp_path):
    running = run_jobs(mark, [(str(tmp_path / name),) for name in "abcd"], 1)
    next(running)
    running.close()
    time.sleep(1.5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a"]


def test_processes_of_a_killed_parent_end(tmp_path):
    """They would finish their jobs, and overwrite what the next run has done by then."""
    script = (
        "from recon.batch.workers import run_jobs; from tests.batch.test_workers import mark\n"
        f"if __name__ == '__main__':\n    list(run_jobs(mark, [('{tmp_path}/a',)], 1))\n"
    )
    (tmp_path / "script.py").write_text(script)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    started = time.monotonic()
    parent = subprocess.Popen([sys.executable, tmp_path / "script.py"], env=environment)
    children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
    if not children.exists():
        parent.kill()
        parent.wait()
        pytest.skip("needs Linux's list of children")
    while len(children.read_text().split()) < 2:  # the worker, and python's resource tracker
        time.sleep(0.01)
        assert time.monotonic() - started < 60
    pids = children.read_text().split()
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 60
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        time.sleep(0.05)
        assert time.monotonic() < deadline, "a worker outlived its parent"
