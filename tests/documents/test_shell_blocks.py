"""Shell commands of the documents are ones that there are, with options that they have."""

import importlib.util
import re
from pathlib import Path

import pytest

from recon.cli.parsing import parsed_command as command
from tests.documents.blocks import PAGES, ROOT, Block, blocks, commands

SHELL = [b for page in PAGES for language in ("bash", "sh") for b in blocks(page, language)]


def parsed(words: list[str]) -> str:
    """The verb that `recon WORDS` would run, after all its arguments were read; it does not run.

    Raises:
        SystemExit: when the command line is refused.
    """
    command(words)
    return words[0]


@pytest.mark.parametrize("block", SHELL, ids=str)
def test_shell_blocks_are_commands(block: Block) -> None:
    for words in commands(block):
        program, *rest = words
        match program:
            case "recon" if rest[0] != "--tyro-print-completion":
                assert parsed(rest) == rest[0], f"{block}: {words}"
            case "make":
                makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
                assert re.search(rf"^{rest[0]}:", makefile, re.M), f"{block}: no target {rest[0]}"
            case "python":
                assert _is_there(rest), f"{block}: {words}"
            case "blender":
                assert _is_there([rest[rest.index("--python") + 1]]), f"{block}: {words}"
            case "recon" | "mkdir" | "source":
                pass
            case _:
                assert words[:2] == ["pip", "install"], f"{block}: unknown program {program}"
                folders = [word.partition("[")[0] for word in words if word.startswith(".")]
                assert all((ROOT / one / "pyproject.toml").is_file() for one in folders), block


def _is_there(words: list[str]) -> bool:
    if words[0] == "-m":
        return importlib.util.find_spec(words[1]) is not None
    return (ROOT / words[0]).is_file()


INDENTED = [
    (page, line.split("#")[0].split())
    for page in PAGES
    for line in page.read_text(encoding="utf-8").splitlines()
    if re.match(r" {4}(make|python -m) ", line)
]


@pytest.mark.parametrize(("page", "words"), INDENTED, ids=lambda v: getattr(v, "name", str(v)))
def test_commands_beside_tables_are_there(page: Path, words: list[str]) -> None:
    del page
    if words[0] == "make":
        assert f"\n{words[1]}:" in (ROOT / "Makefile").read_text(encoding="utf-8")
    else:
        assert _is_there(words[1:])


@pytest.mark.parametrize("words", [["fit", "a.npz", "--outt", "b"], ["fly"], ["fit"]])
def test_a_wrong_command_is_noticed(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        parsed(words)
    assert ended.value.code == 2
    assert capsys.readouterr().err
