"""Results and reports come together or not at all; what recon wrote it knows as its own."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from recon.formats.outputs import Output, OutputKind, check_outputs
from recon.formats.reports import read_report
from recon.formats.writing import delayed_signals, write_report, writing, writing_file

REPORT = {"settings": {"seed": 1, "at": float("nan"), "where": Path("a")}}


@pytest.fixture
def heeded():
    """Ctrl-C is heeded, here and in what is started; shells ignore it for what runs beside."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def write(out: Path, text: str, *, overwrite: bool = False) -> None:
    with writing_file(out, REPORT, overwrite=overwrite) as staged:
        staged.write_text(text)


def fill(folder: Path, names: dict[str, str], *, overwrite: bool = False) -> None:
    output = Output(folder, OutputKind.FOLDER)
    with writing(output, report=REPORT, overwrite=overwrite) as (staged,):
        for name, text in names.items():
            (staged / name).parent.mkdir(exist_ok=True)
            (staged / name).write_text(text)


def listed(folder: Path) -> dict[str, str]:
    """Texts of the files below a folder but reports, hidden ones included."""
    found = {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}
    return {n: p.read_text() for n, p in found.items() if not n.endswith(".json")}


def test_a_result_has_a_report_that_knows_it(tmp_path):
    out = tmp_path / "new" / "m.npz"
    write(out, "one")
    report = read_report(tmp_path / "new" / "m.npz.json")
    assert report is not None
    assert report.checksum_if_own("m.npz", out) is not None
    assert sorted(one.name for one in out.parent.iterdir()) == ["m.npz", "m.npz.json"]
    write(out, "two")
    assert out.read_text() == "two"


@pytest.mark.parametrize("changed", ["m.npz", "m.npz.json"])
def test_what_was_changed_since_is_not_written_over(changed, tmp_path):
    out = tmp_path / "m.npz"
    write(out, "one")
    if changed == out.name:
        out.write_text("edited")
    else:
        report = json.loads((tmp_path / changed).read_text())
        (tmp_path / changed).write_text(json.dumps({**report, "note": "the patient limped"}))
    with pytest.raises(FileExistsError, match=f"{changed} exists, and recon"):
        write(out, "two")
    write(out, "two", overwrite=True)
    assert out.read_text() == "two"
    write(out, "three")  # its own again


def test_a_report_is_known_whatever_its_spacing(tmp_path):
    write(tmp_path / "m", "one")
    report = tmp_path / "m.json"
    report.write_text(json.dumps(json.loads(report.read_text()), sort_keys=True))
    assert read_report(report) is not None


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", "[" * 100_000, '{"outputs": {}}', '{"report_checksum": "0"}']
)
def test_other_json_is_no_report(text, tmp_path):
    (tmp_path / "m.json").write_text(text)
    assert read_report(tmp_path / "m.json") is None


def test_metrics_are_their_own_report(tmp_path):
    out = tmp_path / "metrics.json"
    write_report(out, {"joints_all": 0.01})
    assert json.loads(out.read_text())["joints_all"] == 0.01
    write_report(out, {"joints_all": 0.02})
    out.write_text(json.dumps({"joints_all": 0.02}))
    with pytest.raises(FileExistsError):
        write_report(out, {"joints_all": 0.03})


def test_a_folder_is_what_was_written_last(tmp_path):
    folder = tmp_path / "views"
    fill(folder, {"a": "1", "sub/b": "2"})
    assert listed(folder) == {"a": "1", "sub/b": "2"}
    fill(folder, {"a": "3", "c": "4"})
    assert listed(folder) == {"a": "3", "c": "4"}
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError, match=r"notes\.txt"):
        fill(folder, {"a": "5"})
    fill(folder, {"a": "5"}, overwrite=True)
    assert listed(folder) == {"a": "5", "notes.txt": "mine"}


def test_an_empty_folder_is_filled_and_not_replaced(tmp_path):
    """It may be a file system of its own, onto which nothing can be moved."""
    folder = tmp_path / "mount"
    folder.mkdir()
    before = folder.stat().st_ino
    fill(folder, {"a": "1"})
    assert folder.stat().st_ino == before
    assert listed(folder) == {"a": "1"}


def test_several_outputs_come_together_or_not_at_all(tmp_path):
    """`view` had written the page when the film failed."""
    outputs = [Output(tmp_path / "page"), Output(tmp_path / "film")]

    def cut_short() -> None:
        with writing(*outputs, report=REPORT) as (page, _):
            page.write_text("page")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cut_short()
    assert list(tmp_path.iterdir()) == []


def test_what_appears_meanwhile_is_not_written_over(tmp_path):
    out = tmp_path / "m.npz"

    def slow() -> None:
        with writing_file(out, REPORT) as staged:
            staged.write_text("mine")
            out.write_text("somebody's")

    with pytest.raises(FileExistsError):
        slow()
    assert listed(tmp_path) == {"m.npz": "somebody's"}


@pytest.mark.parametrize("before", [0, 1, 2])
def test_killed_between_any_two_moves(before, tmp_path, monkeypatch):
    """A motion without its report, or one that belongs to another report, was left."""
    out = tmp_path / "m.npz"
    write(out, "old")
    moves, replace = [], os.replace

    def killed(a: Path, b: Path) -> None:
        if len(moves) == before:
            raise SystemExit
        moves.append(Path(b).name)
        replace(a, b)

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", killed)
        if before < 2:
            with pytest.raises(SystemExit):
                write(out, "new")
        else:
            write(out, "new")
    assert moves == ["m.npz.json", "m.npz"][:before]
    report = read_report(tmp_path / "m.npz.json")
    assert report is not None
    assert report.checksum_if_own("m.npz", out) is not None
    write(out, "newer")  # all of it is recon's own: nothing has to be cleared by hand
    assert out.read_text() == "newer"


def test_messages_name_the_output_and_not_where_it_is_prepared(tmp_path):
    def refused() -> None:
        with writing_file(tmp_path / "m.npz", REPORT) as staged:
            raise ValueError(f"{staged}: not written, trans holds NaN")

    with pytest.raises(ValueError, match=re.escape(f"{tmp_path}/m.npz: not written")):
        refused()


def test_two_outputs_are_two_files(tmp_path):
    with pytest.raises(ValueError, match="would both be written as"):
        check_outputs([Output(tmp_path / "a"), Output(tmp_path / "b" / ".." / "a")])
    with pytest.raises(ValueError, match="would both be written as"):
        check_outputs([Output(tmp_path / "a"), Output(tmp_path / "a.json")])


def test_devices_are_not_replaced():
    """`--out /dev/null` would have replaced the device by a file, for whoever may do so."""
    with pytest.raises(ValueError, match="is no plain file"):
        check_outputs([Output(Path("/dev/null"))])


@pytest.mark.usefixtures("heeded")
def test_signals_wait_for_the_end_of_a_move():
    done = []

    def move() -> None:
        with delayed_signals():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            done.append(True)

    with pytest.raises(KeyboardInterrupt):
        move()
    assert done == [True]


SLOW = """
import sys, time
from pathlib import Path
from recon.cli import main
from recon.cli import listing as verbs
from recon.cli.places import Overwrite, Place, writes
from recon.formats.writing import writing_file

@writes(Place("out"))
def slow(out: Path, overwrite: Overwrite = False) -> None:
    with writing_file(out, {}) as staged:
        staged.write_text("half")
        print("ready", flush=True)
        while True:  # a signal that comes just before a sleep is heeded after it
            time.sleep(0.1)

verbs.CORE = {"slow": None}
verbs.function_of_verb = {"slow": slow}.__getitem__
main()
"""


@pytest.mark.usefixtures("heeded")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_run_leaves_nothing_half_written(number, tmp_path):
    """After SIGKILL nobody can clean up; the next run for the same OUT does."""
    out = tmp_path / "m.npz"
    with subprocess.Popen(
        [sys.executable, "-c", SLOW, "slow", "--out", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as run:  # fmt: skip
        assert run.stdout is not None
        assert run.stdout.readline() == "ready\n"
        run.send_signal(number)
        _, said = run.communicate(timeout=60)
    if number == signal.SIGKILL:
        assert len(list(tmp_path.iterdir())) == 1
        check_outputs([Output(out)])
    else:
        assert run.returncode == 130
        assert "interrupted" in said
        assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []
