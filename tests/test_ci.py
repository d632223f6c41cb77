"""The steps of `scripts.ci`, who calls them, and when a line of the changelog is asked for."""

import os
import re
import subprocess
import sys

import pytest
import yaml

from scripts import ci

CALLERS = [
    ci.ROOT / "Makefile",
    ci.ROOT / ".pre-commit-config.yaml",
    *sorted((ci.ROOT / ".github").rglob("*.yml")),
]


@pytest.mark.parametrize("path", CALLERS, ids=lambda path: path.name)
def test_callers_name_steps_that_there_are(path):
    text = path.read_text(encoding="utf-8")
    if path.suffix in (".yml", ".yaml"):
        assert yaml.safe_load(text)
    called = re.findall(r"(?:python -m scripts\.ci|\$\(CI\)) ([a-z ]+)", text)
    assert {step for steps in called for step in steps.split()} <= {*ci.STEPS, "changelog"}
    assert called or path.parent.name == "ISSUE_TEMPLATE"


def test_an_unknown_step_is_refused_before_any_runs(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["ci", "lint", "tests"])
    monkeypatch.setitem(ci.STEPS, "lint", lambda: pytest.fail("ran"))
    with pytest.raises(SystemExit) as ended:
        ci.main()
    assert ended.value.code == 2
    assert "no step 'tests'; there are install" in capsys.readouterr().err


def test_a_step_ends_with_the_status_of_what_it_ran():
    ci.run("-c", "import os; assert os.environ['KERNELS'] == 'plain'", KERNELS="plain")
    with pytest.raises(SystemExit) as ended:
        ci.run("-c", "import sys; sys.exit(3)")
    assert ended.value.code == 3


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A function that commits text to files of a repository whose branch `base` is behind."""
    # within a hook of git these name the repository of the hook
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)

    def git(*words):
        who = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    def commit(message, **files):
        for name, text in files.items():
            path = tmp_path / name.replace("__", "/").replace("_md", ".md")
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        git("add", ".")
        git("commit", "--quiet", "--message", message)
        return tmp_path

    git("init", "--quiet")
    commit("Begin", CHANGELOG_md="# Changes\n* one\n", recon__fit="1")
    git("branch", "base")
    return commit


def test_a_change_of_the_library_asks_for_a_line(repository):
    repository("Fit faster", recon__fit="2")
    root = repository("Tell more", docs__page="2")
    (told,) = ci.unlisted(root, "base")
    assert told.endswith(" Fit faster")
    with pytest.raises(SystemExit, match=r"Fit faster\n.*'no changelog'"):
        ci.changelog(root, "base")
    root = repository("Say so", CHANGELOG_md="# Changes\n* one\n* two\n")
    assert ci.unlisted(root, "base") == []


def test_to_delete_a_line_is_not_to_add_one(repository):
    root = repository("Fit slower", priors__pose="2", CHANGELOG_md="# Changes\n")
    assert len(ci.unlisted(root, "base")) == 1


def test_a_message_may_say_that_users_notice_nothing(repository):
    root = repository("Rename a file\n\nNo changelog\n", recon__fit="2")
    assert ci.unlisted(root, "base") == []
    root = repository("Speak of no changelog", observations__points="3")
    (told,) = ci.unlisted(root, "base")
    assert told.endswith("Speak of no changelog")


def test_documents_alone_ask_for_no_line(repository):
    assert ci.unlisted(repository("Explain", docs__page="2", README_md="3"), "base") == []


def test_an_unknown_base_is_refused(repository):
    with pytest.raises(SystemExit, match="elsewhere"):
        ci.unlisted(repository("Explain", README_md="3"), "elsewhere")
