"""The steps of continuous integration, which `make`, pre-commit and the workflows call.

    python -m scripts.ci lint types test
    python -m scripts.ci changelog --base origin/main

Steps run in the order given, with the Python that runs this program; the first that fails ends it.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = ("recon/", "priors/", "observations/", "training/")
"""Folders whose changes users notice."""
EXEMPT = "no changelog"
"""Line of a commit's message by which it needs no changelog: users notice nothing of it."""
PIP = ("-m", "pip", "install", "--quiet", "--constraint", "constraints.txt")
TESTS = ("-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "-m")
PLAIN_KERNELS = {"ATEN_CPU_CAPABILITY": "default", "MKL_CBWR": "COMPATIBLE"}
AVX2_KERNELS = {"ATEN_CPU_CAPABILITY": "avx2"}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    told = ", ".join([*STEPS, "changelog"])
    parser.add_argument("steps", nargs="+", metavar="STEP", help=told)
    parser.add_argument("--base", default="origin/main", help="what `changelog` compares with")
    arguments = parser.parse_args()
    for step in arguments.steps:
        if step not in STEPS and step != "changelog":
            parser.error(f"no step {step!r}; there are {told}")
    for step in arguments.steps:
        if step == "changelog":
            changelog(ROOT, arguments.base)
        else:
            STEPS[step]()


def run(*words: str, **environment: str) -> None:
    """Run this Python with arguments, in the root of the checkout.

    Raises:
        SystemExit: with the exit status, if it is not 0.
    """
    said = [f"{name}={value}" for name, value in environment.items()]
    print("+", *said, "python", *words, flush=True)
    ended = subprocess.run(
        [sys.executable, *words], cwd=ROOT, env={**os.environ, **environment}, check=False
    )
    if ended.returncode:
        sys.exit(ended.returncode)


def install() -> None:
    """Install the package with its dependencies, at the versions of constraints.txt."""
    run("-m", "pip", "install", "--quiet", "--upgrade", "pip>=25.1")
    run(*PIP, "--editable", ".")


def develop() -> None:
    """Install what the other steps need besides the package, and the extra `film`."""
    run(*PIP, "--group", "dev", "--editable", "film-models", "--editable", ".[film]")


def demo() -> None:
    run("-m", "recon", "demo", "--out", "demo")


def lint() -> None:
    run("-m", "ruff", "check", ".")
    run("-m", "ruff", "format", "--check", ".")
    run("-c", "from importlinter.cli import lint_imports_command as lint; lint()")


def types() -> None:
    run("-m", "pyright", "--pythonpath", sys.executable)


def test() -> None:
    """Run all tests but slow ones; those that depend on rounding with inputs changed by 4 ulps."""
    run(*TESTS, "not slow and not numerics")
    run(*TESTS, "numerics and not slow", "--ulps", "4")


def numerics(kernels: dict[str, str] = PLAIN_KERNELS) -> None:
    """Run tests that depend on rounding on other kernels, from inputs changed by 4 ulps.

    Shapes of arrays are not checked again, since they do not depend on rounding.
    """
    run(*TESTS, "numerics and not slow", "--ulps", "4", JAXTYPING_DISABLE="1", **kernels)


def slow() -> None:
    """Run the tests marked `slow`, and `numerics` on two other sets of kernels."""
    run(*TESTS, "slow")
    numerics()
    numerics(AVX2_KERNELS)


def extras() -> None:
    """Install the extra `open3d`, 0.9 GB, and run the tests that are skipped without it."""
    run(*PIP, "--editable", ".[open3d]")
    run("-c", "import open3d")  # on Linux it needs libusb of the system, and fails here without
    run("-m", "pytest", "-q", "-n", "0", "tests/api/test_open3d.py")


def figures() -> None:
    run("-m", "scripts.figures", "--gate")


def dist() -> None:
    run("-m", "scripts.distributions", "--out", "dist")


def docs() -> None:
    run("-m", "mkdocs", "build", "--quiet", NO_MKDOCS_2_WARNING="1")


_STEPS = (install, develop, demo, lint, types, test, numerics, slow, extras, figures, dist, docs)
STEPS: dict[str, Callable[[], None]] = {step.__name__: step for step in _STEPS}


def changelog(root: Path, base: str) -> None:
    """End the program when CHANGELOG.md has no line for commits that ask for one."""
    if told := unlisted(root, base):
        sys.exit(
            "These commits change the library, and CHANGELOG.md has no new line:\n"
            + "".join(f"  {line}\n" for line in told)
            + f"Add one, or the line {EXEMPT!r} to their messages where users notice nothing."
        )
    print(f"changelog: nothing is missing since {base}")


def unlisted(root: Path, base: str) -> list[str]:
    """List commits since a base that need a line of the changelog; none if it has a new one."""
    added = git(root, "diff", "--numstat", f"{base}...HEAD", "--", "CHANGELOG.md")
    if added and not added.startswith("0\t"):
        return []
    commits = git(root, "log", "--no-merges", "--format=%h", f"{base}..HEAD").split()
    return [git(root, "log", "-1", "--format=%h %s", one) for one in commits if asks(root, one)]


def asks(root: Path, commit: str) -> bool:
    """Whether a commit changes the library, and its message does not exempt it."""
    message = git(root, "log", "-1", "--format=%B", commit).splitlines()
    names = git(root, "diff-tree", "-r", "--root", "--no-commit-id", "--name-only", commit)
    exempt = EXEMPT in (line.strip().lower() for line in message)
    return not exempt and any(name.startswith(LIBRARY) for name in names.splitlines())


def git(root: Path, *words: str) -> str:
    """Run git; return its output.

    Raises:
        SystemExit: with its error message, if it fails.
    """
    ended = subprocess.run(
        ["git", *words], cwd=root, capture_output=True, check=False, encoding="utf-8"
    )
    if ended.returncode:
        sys.exit(f"git {' '.join(words)}: {ended.stderr.strip()}")
    return ended.stdout.strip()


if __name__ == "__main__":
    main()
