"""No verb writes over its input or over others' files: every verb x every kind of bad OUT."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from recon import cli
from recon.cli import listing as verbs
from recon.formats.outputs import OutputKind
from tests.verbs import declared_outputs
from training.__main__ import train


@dataclass(frozen=True)
class Case:
    """A verb with one of its outputs, `OUT` among the arguments, and its first input, `IN`."""

    verb: str
    output: str
    arguments: tuple[str, ...]
    kind: OutputKind = OutputKind.FILE

    @property
    def suffix(self) -> str:
        """Which the name of the output must have."""
        return next(Path(one).suffix for one in self.arguments if one.startswith("OUT"))

    @property
    def reads(self) -> bool:
        """Whether there is an input that could be lost."""
        return any(one.startswith("IN") for one in self.arguments)

    def __str__(self) -> str:
        return f"{self.verb}-{self.output}-{self.kind.name.lower()}"


CASES = (
    Case("demo", "out", ("--out", "OUT"), OutputKind.FOLDER),
    Case("detect", "out", ("IN.npz", "--out", "OUT.npz")),
    Case("fit", "out", ("IN.npz", "--out", "OUT")),
    Case("complete", "out", ("IN.npz", "--out", "OUT")),
    Case("batch", "out", ("IN.jsonl", "--out", "OUT"), OutputKind.CONTINUED),
    Case("convert", "out", ("IN.trc", "OUT")),
    Case("convert-all", "out", ("IN.folder", "OUT"), OutputKind.CONTINUED),
    Case("fit-all", "out", ("IN.json", "--out", "OUT"), OutputKind.FOLDER),
    Case("sample", "out", ("--out", "OUT.npz", "--weights", "IN.npz")),
    Case(
        "sample", "out", ("--out", "OUT", "--count", "2", "--weights", "IN.npz"), OutputKind.FOLDER
    ),
    Case("predict", "out", ("IN.npz", "--out", "OUT.npz")),
    Case("predict", "out", ("IN.npz", "--out", "OUT", "--samples", "2"), OutputKind.FOLDER),
    Case("register", "out", ("IN.npz", "other.npz", "--out", "OUT"), OutputKind.FOLDER),
    Case("calibrate", "out", ("IN.npz", "other.npz", "--out", "OUT.toml")),
    Case("interpolate", "out", ("other.npz", "IN.npz", "--out", "OUT")),
    Case("refine", "out", ("IN.npz", "--out", "OUT", "--prior", "pose")),
    Case("retarget", "out", ("IN.npz", "--out", "OUT", "--shape", "0")),
    Case("simulate", "out", ("IN.npz", "OUT.npz", "--kind", "joints3d")),
    Case("simulate", "out", ("IN.npz", "OUT", "--kind", "scans"), OutputKind.FOLDER),
    Case("evaluate", "json", ("IN.npz", "other.npz", "--json", "OUT"), OutputKind.REPORT),
    Case("report", "out", ("IN.trc", "--out", "OUT.html")),
    *(Case("view", to, ("IN.npz", f"--{to}", "OUT")) for to in ("html", "png", "mp4", "rrd")),
    *(
        Case("export", to, ("IN.npz", f"--{to}", "OUT"))
        for to in ("glb", "usd", "bvh", "trc", "mot", "angles", "joints", "html")
    ),
    Case("export", "robot", ("IN.npz", "--robot", "OUT", "--smplx", "other.npz")),
    Case("export", "smpl", ("IN.npz", "--smpl", "OUT", "--onto", "other.npz")),
    Case("export", "forces", ("IN.npz", "--forces", "OUT.mot", "--mass", "70")),
    Case("export", "moments", ("IN.npz", "--moments", "OUT.sto", "--mass", "70")),
    Case("label", "out", ("IN.trc", "--like", "other.npz", "--out", "OUT.trc")),
    Case("export", "ply", ("IN.npz", "--ply", "OUT"), OutputKind.FOLDER),
    Case("bench", "json", ("gap", "--splits", "IN.npz", "--json", "OUT"), OutputKind.REPORT),
    Case("bench", "write", ("gap", "--splits", "IN.npz", "--write", "OUT"), OutputKind.FOLDER),
)
"""Every output that any verb declares."""


def test_every_output_of_every_verb_is_tried():
    """A verb or an output added later is missed here until it has a case of its own."""
    every = {name: declared_outputs(verbs.function_of_verb(name)) for name in verbs.verb_names()}
    known = {(name, place.parameter) for name, places in every.items() for place in places}
    assert {(case.verb, case.output) for case in CASES} == known
    assert {name for name, places in every.items() if not places} == {"info", "stream"}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Inputs that hold nonsense: who reads them before looking at OUT says something else."""
    (tmp_path / "in").mkdir()
    for name in ("IN.npz", "IN.trc", "IN.folder/clip.bvh", "other.npz", "clip.npz"):
        (tmp_path / "in" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "in" / name).write_text(f"nonsense in {name}")
    line = {"id": "clip", "observations": ["clip.npz"]}
    (tmp_path / "in" / "IN.jsonl").write_text(json.dumps(line))
    (tmp_path / "in" / "IN.json").write_text('{"people": [')
    return tmp_path


def an_input(case: Case, place: Path) -> tuple[Path, str]:
    given = next(place / "in" / one for one in case.arguments if one.startswith("IN"))
    if case.kind in (OutputKind.FOLDER, OutputKind.CONTINUED) and given.is_file():
        return place / "in", "holds the input"
    return given, "is the input"


def a_folder(case: Case, place: Path) -> tuple[Path, str]:
    out = place / f"out{case.suffix}"
    if case.kind in (OutputKind.FOLDER, OutputKind.CONTINUED):
        out.write_text("a file")
        return out, "is a file; give the name of a folder"
    out.mkdir()
    return out, "is a folder; give the name of a file"


def below_a_file(case: Case, place: Path) -> tuple[Path, str]:
    (place / "file").write_text("somebody's")
    return place / "file" / "deeper" / f"out{case.suffix}", "would lie below"


def not_writable(case: Case, _: Path) -> tuple[Path, str]:
    # nobody, root included, can make a file there
    return Path("/proc") / f"recon-test{case.suffix}", "cannot be written"


def somebodys_file(case: Case, place: Path) -> tuple[Path, str]:
    out = place / f"out{case.suffix}"
    if case.kind in (OutputKind.FOLDER, OutputKind.CONTINUED):
        out.mkdir()
        (out / "notes.txt").write_text("somebody's")
    else:
        out.write_text("somebody's")
    return out, "--overwrite"


def somebodys_report(case: Case, place: Path) -> tuple[Path, str]:
    out = place / f"out{case.suffix}"
    if case.kind in (OutputKind.FOLDER, OutputKind.CONTINUED):
        out.mkdir()
        name = "log.jsonl" if case.verb == "batch" else "report.json"
        (out / name).write_text('{"patient": 7}\n')
    else:
        name = out.name if case.kind is OutputKind.REPORT else f"{out.name}.json"
        (place / name).write_text('{"patient": 7}')
    return out, "--overwrite"


def a_circle(case: Case, place: Path) -> tuple[Path, str]:
    """`simulate` replaced a link that leads to itself, and said that all was well."""
    out, other = place / f"out{case.suffix}", place / f"back{case.suffix}"
    out.symlink_to(other)
    other.symlink_to(out)
    return out, "lead in a circle"


BAD = (
    an_input, a_folder, below_a_file, not_writable, somebodys_file, somebodys_report, a_circle,
)  # fmt: skip


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.__name__)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_bad_out_is_refused_before_any_work(case, bad, place, capsys):
    """OUT was looked at after the work, and replaced whatever it was: inputs, too."""
    if bad is an_input and not case.reads:
        pytest.skip(f"{case.verb} reads nothing")
    if bad is not_writable and not Path("/proc/self").exists():
        pytest.skip("this system has no folder that nobody can write to")
    out, words = bad(case, place)
    before = contents(place)
    given = [
        str(out) if one.startswith("OUT") else
        str(place / "in" / one) if one.startswith(("IN", "other")) else one
        for one in case.arguments
    ]  # fmt: skip
    assert cli.run([case.verb, *given]) == cli.BAD_INPUT
    assert words in " ".join(capsys.readouterr().err.split())
    assert contents(place) == before


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every file below a folder with its bytes, and every folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def relative(path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(path.parent)
    return Path("..") / path.parent.name / "." / path.name


def symbolic(path: Path, _: pytest.MonkeyPatch) -> Path:
    (path.parent / "link.npz").symlink_to(path)
    return path.parent / "link.npz"


def chained(path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (path.parent.parent / "folder").symlink_to(path.parent)
    return symbolic(path.parent.parent / "folder" / path.name, monkeypatch)


def hard(path: Path, _: pytest.MonkeyPatch) -> Path:
    os.link(path, path.parent / "hard.npz")
    return path.parent / "hard.npz"


def unfinished(path: Path, _: pytest.MonkeyPatch) -> Path:
    """The input is what would be the report."""
    path.rename(path.with_name("IN.npz.json"))
    path.symlink_to(path.with_name("IN.npz.json"))
    return path.with_name("IN.npz")


@pytest.mark.parametrize("spelt", [relative, symbolic, chained, hard, unfinished])
@pytest.mark.parametrize("overwrite", [False, True])
def test_an_input_is_known_by_any_name(spelt, overwrite, place, capsys, monkeypatch):
    """`--overwrite` is for others' files; an input is never written over."""
    given = place / "in" / "IN.npz"
    out = spelt(given, monkeypatch)
    before = contents(place)
    options = ["--overwrite"] if overwrite else []
    assert cli.run(["fit", str(given), "--out", str(out), *options]) == cli.BAD_INPUT
    assert "is the input" in " ".join(capsys.readouterr().err.split())
    assert contents(place) == before


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.__name__)
@pytest.mark.parametrize("prior", ["pose", "humor"])
def test_a_training_refuses_a_bad_out(prior, bad, place, capsys):
    """`python -m training` writes as verbs do."""
    case = Case("train", "out", (prior, "IN.folder", "--out", "OUT.st"))
    out, words = bad(case, place)
    if bad is an_input:
        out, words = out / "weights.st", "lies in the input"
    before = contents(place)
    given = (prior, place / "in" / "IN.folder")
    assert cli.run_command(lambda: train(*given, out=out)) == cli.BAD_INPUT
    assert words in " ".join(capsys.readouterr().err.split())
    assert contents(place) == before
