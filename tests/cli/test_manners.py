"""Manners of the command line: help, suggestions, silence, missing files, and a quick start."""

import inspect
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import recon
from recon import cli
from recon.cli import console, inputs, listing
from recon.cli.examples import EXAMPLES
from recon.cli.parsing import BAD_USAGE, options_of, parsed_command
from tests.verbs import declared_outputs

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"
VERBS = {name: listing.function_of_verb(name) for name in listing.verb_names()}
COMMANDS = [command for examples in EXAMPLES.values() for command in examples]


def ended(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int | str | None, str]:
    """Code and words with which a command line ends before any verb runs."""
    with pytest.raises(SystemExit) as end:
        cli.run(shlex.split(words))
    shown = capsys.readouterr()
    return end.value.code, " ".join((shown.out + shown.err).split())


def test_every_verb_has_two_examples_or_more_in_its_help(capsys):
    assert set(EXAMPLES) == set(VERBS)
    for verb, examples in EXAMPLES.items():
        assert len(examples) >= 2
        code, text = ended(f"{verb} --help", capsys)
        assert code == 0
        assert all(example in text for example in examples)


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_are_commands(command):
    program, verb, *words = shlex.split(command)
    assert program == "recon"
    call = parsed_command([verb, *words])
    whole = "--all" in words or "--person all" in command
    expected = VERBS[f"{verb}-all" if whole else verb]
    assert inspect.unwrap(getattr(call, "func")) is inspect.unwrap(expected)  # noqa: B009


@pytest.mark.parametrize(
    ("words", "said", "unsaid"),
    [
        ("fit a.npz --out b.npz --priro pose", "did you mean --prior?", "recon sample"),
        ("fit a.npz --output b.npz", "did you mean --out?", "Missing"),
        ("view a.npz --hmtl b.html", "did you mean --html?", "--mp4"),
        ("fit a.npz --out b.npz --hide-below 1", "no option --hide-below;", "did you mean"),
        ("fitt a.npz", "did you mean fit?", "Unrecognized"),
        ("info -trial.c3d", "a file of this name is ./-trial.c3d", "did you mean"),
        ("--versoin", "no option --versoin", "--person"),
        ("fit a.npz --out b.npz --device gpu", "'cpu', 'cuda'", "did you mean"),
        ("fit '' --out b.npz", "one argument is empty", "lies in the input"),
        ("register a b --out=", "one argument is empty", "expected"),
    ],
)
def test_what_is_no_command_is_refused_with_what_was_meant(words, said, unsaid, capsys):
    """Suggestions were other verbs' options; a misspelt --out was said to be missing."""
    code, text = ended(words, capsys)
    assert code == cli.BAD_INPUT
    assert said in text
    assert unsaid not in text


@pytest.mark.parametrize("verb", VERBS)
def test_options_are_those_of_the_help(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit):
        cli.run([verb, "--help"])
    told = re.findall(r"^[│ ]+(-h|--[a-z][\w-]*)(, --[\w-]+)?", capsys.readouterr().out, re.M)
    words = {word.strip() for pair in told for part in pair for word in part.split(",")} - {""}
    assert words == {one for one in options_of(VERBS[verb]) if "tyro" not in one}


def test_underscores_and_negative_numbers_are_no_unknown_options(tmp_path):
    call = parsed_command(
        ["simulate", "a.npz", "b.npz", "--kind", "joints3d", "--hide_below", "-0.5"]
    )
    assert getattr(call, "keywords")["hide_below"] == -0.5  # noqa: B009


def test_the_list_of_verbs_and_a_script_for_the_shell(capsys):
    code, text = ended("", capsys)
    assert code == 0
    assert all(re.search(rf"[^\w-] {verb} [A-Z]", text) for verb in VERBS)
    code, text = ended("--tyro-print-completion bash", capsys)
    assert not code
    assert "--frame-rate" in text


def test_version(capsys):
    assert cli.run(["--version"]) == cli.OK
    words = capsys.readouterr().out.split()
    assert words[:2] == ["recon", f"{recon.__version__},"]
    assert {"torch", "Python"} <= set(words)


def test_info_is_written_where_pipes_find_it(capsys):
    """The table was written to stderr."""
    assert cli.run(["info", str(DEMO)]) == cli.OK
    shown = capsys.readouterr()
    assert "motion (AMASS .npz)" in shown.out
    assert shown.err == ""


def test_a_table_without_rows_is_its_title(capsys):
    """A report without cycles of gait had its title in letters below each other."""
    console.print_table("trial.c3d: 0 cycles of gait", {})
    assert capsys.readouterr().err == "trial.c3d: 0 cycles of gait\n"


def test_quiet_leaves_the_last_line_and_what_went_wrong(capsys):
    with console.quiet_if(True):
        console.print_progress("said")
        console.print_note("noted")
        console.print_warning("warned")
        console.print_table("tabled", {"row": {"column": 1}})
        console.print_findings({"warnings": [{"message": "found"}]})
        console.print_error("clip 3 has no frames")
        console.print_last_line("out.npz")
        console.print_json({"n": 1})
    shown = capsys.readouterr()
    assert shown.err.splitlines() == ["clip 3 has no frames", "out.npz"]
    assert json.loads(shown.out) == {"n": 1}
    console.print_progress("said")
    assert capsys.readouterr().err == "said\n"


def test_a_quiet_verb_says_where_its_result_is(tmp_path, capsys):
    bvh, out = tmp_path / "m.bvh", tmp_path / "back.npz"
    assert cli.run(["export", str(DEMO), "--bvh", str(bvh)]) == cli.OK
    assert cli.run(["convert", str(bvh), str(out), "--quiet"]) == cli.OK
    assert capsys.readouterr().err.splitlines() == [str(out)]


def test_every_argument_that_is_read_says_what_it_should_be():
    for verb, function in VERBS.items():
        written = {place.parameter for place in declared_outputs(function)}
        for name, parameter in inspect.signature(function).parameters.items():
            if "Path" in str(parameter.annotation) and name not in written:
                assert name in inputs.EXPECTED, f"{verb}: {name}"
    assert {"camera", "body", "masks"} <= set(inputs.EXPECTED)


def test_a_marker_set_is_given_by_its_name(tmp_path, capsys):
    markers, out = tmp_path / "m.trc", tmp_path / "named.trc"
    assert cli.run(["export", str(DEMO), "--trc", str(markers), "--markers", "pig"]) == cli.OK
    label = ["label", str(markers), "--out", str(out), "--set"]
    assert cli.run([*label, "nosuchset"]) == cli.BAD_INPUT
    assert "expected one of the marker sets" in capsys.readouterr().err
    assert cli.run([*label, str(tmp_path / "mine.toml")]) == cli.BAD_INPUT
    assert "expected a marker set by its name" in capsys.readouterr().err
    assert cli.run([*label, "pig"]) == cli.OK
    assert "100.0 % of the points named" in capsys.readouterr().err


def test_a_missing_file_is_answered_with_its_like(tmp_path, capsys):
    (tmp_path / "walking.npz").touch()
    wanted = tmp_path / "walkin.npz"
    assert cli.run(["view", str(wanted), "--html", str(tmp_path / "m.html")]) == cli.BAD_INPUT
    said = capsys.readouterr().err
    assert "expected a motion file (.npz)" in said
    assert f"did you mean {tmp_path / 'walking.npz'}?" in said
    line = ["fit", str(DEMO), "--out", str(tmp_path / "o.npz")]
    assert cli.run([*line, "--camera", str(tmp_path / "no" / "c.toml")]) == cli.BAD_INPUT
    said = capsys.readouterr().err
    assert "expected a calibration of cameras" in said
    assert f"the folder {tmp_path / 'no'} is not there either" in said


LOADED = """
import sys
{work}
heavy = {{"torch", "numpy", "scipy", "cv2", "viser", "av", "sklearn", "rich", "trimesh"}}
print(sorted(heavy & set(sys.modules)))
"""


@pytest.mark.parametrize(
    "work",
    [
        "import recon",
        "from recon import cli; assert cli.run(['fit', 'no.npz', '--out', 'o.npz']) == 2",
        "from recon import cli; assert cli.run(['info', 'no.npz']) == 2",
        "from recon import cli; assert cli.run(['batch', 'no.jsonl', '--out', 'o']) == 2",
        "from recon import cli; assert cli.run(['--version']) == 0",
    ],
    ids=["import", "fit", "info", "batch", "version"],
)
def test_a_quick_answer_loads_nothing_heavy(work, tmp_path):
    """A missing file was answered after ten seconds of imports on a busy machine."""
    code = LOADED.format(work=work)
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert run.stdout.splitlines()[-1] == "[]"


ROMA = "import sys, recon.api.fit; print({'roma', 'torch._dynamo', 'scipy'} & set(sys.modules))"


def test_a_fit_loads_neither_the_compiler_nor_scipy_before_they_are_used():
    """RoMa loaded torch's compiler: a third of every start."""
    run = subprocess.run([sys.executable, "-c", ROMA], capture_output=True, text=True, check=True)
    assert run.stdout == "set()\n"


def test_links_to_nothing_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The message asked whether the very same path was meant."""
    (tmp_path / "seen.npz").symlink_to("gone.npz")
    assert cli.run(["info", str(tmp_path / "seen.npz")]) == BAD_USAGE
    assert "it is a link to gone.npz, where nothing is" in capsys.readouterr().err
