"""Measures the size of the project: what one must read, keep and download.

    python -m scripts.figures
    python -m scripts.figures --json
    python -m scripts.figures --gate
    python -m scripts.figures --root OTHER_CHECKOUT

Counted are files that git tracks, as they are in the working tree. `scripts/figures.toml` has for
each figure the ceiling in force and the value that is aimed at; with --gate the program fails when
a figure is above its ceiling. A commit that makes a figure smaller lowers its ceiling.
"""

import argparse
import ast
import json
import os
import statistics
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LIMITS = ROOT / "scripts" / "figures.toml"
PACKAGES = ("recon", "priors", "observations", "training")
RESULTS = "benchmarks/results/"
MEANINGS = {
    "statements": "statements of the packages",
    "statements_all": "statements of all Python but tests/",
    "docstring_percent": "% of the packages' lines that are docstrings",
    "first_fit_modules": "modules loaded by a first fit of joints",
    "first_fit_lines": "lines of these modules",
    "first_fit_functions": "functions and classes entered by recon.fit",
    "first_fit_files": "files that these stand in",
    "files": "Python files of the packages",
    "longest_file": "lines of the longest of them",
    "median_file": "lines of the median of them, __init__.py apart",
    "folders": "folders of the packages with Python in them",
    "levels": "levels of these, the package itself the first",
    "protocols": "classes that derive from typing.Protocol",
    "names": "public names of `recon`",
    "verbs": "verbs of the command line",
    "words": "words of README.md and docs/, without migration",
    "result_bytes": "bytes of benchmarks/results",
    "benchmark_lines": "lines of Python of benchmarks/",
    "test_lines": "lines of Python of tests/",
}


def main() -> None:
    """Print the figures; with --gate, fail when one is above its ceiling."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout to count")
    parser.add_argument("--limits", type=Path, default=LIMITS, help="ceilings, as TOML")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--gate", action="store_true", help="fail above a ceiling")
    parser.add_argument("--first-fit", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.first_fit:
        print(json.dumps(first_fit(arguments.root)))
        return
    limits = tomllib.loads(text_of(arguments.limits))
    if unknown := sorted(limits.keys() - MEANINGS.keys()):
        sys.exit(f"{arguments.limits.name}: no figure is called {', '.join(unknown)}")
    figures = counted(arguments.root.resolve())
    print(json.dumps(figures, indent=1) if arguments.json else table(figures, limits))
    if arguments.gate and (found := exceeded(figures, limits)):
        sys.exit("\n".join(found))


def counted(root: Path) -> dict[str, float]:
    """Count every figure of a checkout, keyed as in MEANINGS."""
    files = tracked(root)
    python = {name: text_of(root / name) for name in files if name.endswith(".py")}
    of = {name: text for name, text in python.items() if name.split("/")[0] in PACKAGES}
    trees = {name: ast.parse(text) for name, text in python.items()}
    lines = {name: len(text.splitlines()) for name, text in python.items()}
    own = [lines[name] for name in of]
    docstrings = sum(height(node) for name in of for node in bare_strings(trees[name]))
    folders = {name.rpartition("/")[0] for name in of}
    figures: dict[str, float] = {
        "statements": sum(statements(trees[name]) for name in of),
        "statements_all": sum(
            statements(trees[name]) for name in python if not name.startswith("tests/")
        ),
        "docstring_percent": round(100 * docstrings / sum(own), 1),
        "files": len(own),
        "longest_file": max(own),
        "median_file": statistics.median(
            lines[name] for name in of if not name.endswith("__init__.py")
        ),
        "folders": len(folders),
        "levels": max(folder.count("/") + 1 for folder in folders),
        "protocols": sum(protocols(trees[name]) for name in of),
        "verbs": verbs(root),
        "words": sum(len(text_of(root / name).split()) for name in files if is_document(name)),
        "result_bytes": sum(
            (root / name).stat().st_size for name in files if name.startswith(RESULTS)
        ),
        "benchmark_lines": sum(lines[name] for name in python if name.startswith("benchmarks/")),
        "test_lines": sum(lines[name] for name in python if name.startswith("tests/")),
    }
    figures |= json.loads(
        run(root, str(Path(__file__).resolve()), "--first-fit", "--root", str(root))
    )
    return {key: figures[key] for key in MEANINGS}


def tracked(root: Path) -> list[str]:
    """List the files that git tracks and that exist, by their names with slashes."""
    command = ["git", "ls-files", "-z"]
    found = subprocess.run(command, cwd=root, capture_output=True, check=True).stdout.decode()
    return [name for name in found.split("\0") if name and (root / name).is_file()]


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def is_document(name: str) -> bool:
    """Whether a file is README.md or a page of docs/ other than migration.md."""
    page = name.startswith("docs/") and name.endswith(".md")
    return name == "README.md" or (page and name != "docs/migration.md")


def bare_strings(tree: ast.AST) -> Iterator[ast.Expr]:
    """Yield docstrings of modules, classes and functions, and those below fields and constants."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                yield node


def height(node: ast.Expr) -> int:
    """Return the number of lines of a statement."""
    return (node.end_lineno or node.lineno) - node.lineno + 1


def statements(tree: ast.AST) -> int:
    """Count statements, also inside others, but no docstrings of modules, classes, functions.

    Docstrings of fields and constants count.
    """
    nodes = list(ast.walk(tree))
    having = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    told = sum(isinstance(node, having) and ast.get_docstring(node) is not None for node in nodes)
    return sum(isinstance(node, ast.stmt) for node in nodes) - told


def protocols(tree: ast.AST) -> int:
    """Count classes that derive from `Protocol` or `Protocol[...]` directly."""
    classes = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    bases = ([ast.unparse(base).partition("[")[0] for base in one.bases] for one in classes)
    return sum(bool({"Protocol", "typing.Protocol"} & set(names)) for names in bases)


def verbs(root: Path) -> int:
    """Count the verbs that `recon --help` lists in its usage."""
    usage = run(root, "-m", "recon", "--help").partition("{")[2].partition("}")[0]
    return len(usage.split(","))


def run(root: Path, *words: str) -> str:
    """Run this Python in a new process that imports a checkout's packages; return its output."""
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, *words]
    return subprocess.run(
        command, cwd=root, env=environment, stdout=subprocess.PIPE, check=True, encoding="utf-8"
    ).stdout


def first_fit(root: Path) -> dict[str, int]:
    """Count what a first fit loads and enters, and public names; needs a new process.

    The joints are arrays in memory: a second of the bundled walk with noise of 2 cm, taken from
    its file by numpy, as a fit of joints needs no reader of motions. Counted as entered is every
     function and class body of ours, as `sys.setprofile` sees them from the lookup of
    `recon.fit` on, imports included; lambdas and comprehensions are not counted.
    """
    import numpy as np
    import torch
    from scipy.spatial.transform import Rotation

    import recon

    names = len(public_names(recon))

    with np.load(ROOT / "recon" / "assets" / "demo.npz") as walk:
        turns = Rotation.from_rotvec(walk["poses"][:30].reshape(-1, 3)).as_matrix()
        given = (walk["trans"][:30], turns.reshape(30, 22, 3, 3), walk["betas"])
    truth = recon.Motion.create(*(torch.tensor(part).float() for part in given), fps=30.0)
    joints = recon.BodyModel.load().pose(truth).joints.numpy()
    joints = joints + np.random.default_rng(0).normal(0, 0.02, joints.shape)
    sensor = recon.Joints3D
    entered: set[tuple[str, str, int]] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and not code.co_name.startswith("<"):
            entered.add((code.co_filename, code.co_qualname, code.co_firstlineno))

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        recon.fit(sensor(joints, np.ones(joints.shape[:2], dtype=bool), range(22), fps=30.0))
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    own = {str(path) for name in PACKAGES for path in (root / name).rglob("*.py")}
    loaded = own & {str(getattr(module, "__file__", None)) for module in [*sys.modules.values()]}
    functions = [one for one in entered if one[0] in own]
    return {
        "names": names,
        "first_fit_modules": len(loaded),
        "first_fit_lines": sum(len(text_of(Path(path)).splitlines()) for path in loaded),
        "first_fit_functions": len(functions),
        "first_fit_files": len({path for path, _, _ in functions}),
    }


def public_names(package: Any) -> list[str]:
    """List the names that a package itself offers, also those loaded on first use."""
    at_hand = vars(package)
    homes = {name: str(getattr(at_hand.get(name), "__module__", "")) for name in dir(package)}
    return [
        name
        for name, home in homes.items()
        if not name.startswith("_") and (name not in at_hand or home.split(".")[0] in PACKAGES)
    ]


def table(figures: Mapping[str, float], limits: Mapping[str, Mapping[str, float]]) -> str:
    """Format a line per figure: value, the ceiling in force, the value asked for, its meaning."""
    rows: list[Iterable[str]] = [("now", "ceiling", "asked", "")]
    for key, value in figures.items():
        limit = limits.get(key, {})
        shown = (value, limit.get("ceiling"), limit.get("asked"))
        words = ("" if number is None else f"{number:,}" for number in shown)
        rows.append((*words, f"{MEANINGS[key]} ({key})"))
    return "\n".join("{:>10} {:>10} {:>9}  {}".format(*row).rstrip() for row in rows)


def exceeded(figures: Mapping[str, float], limits: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return a sentence for every figure that is above its ceiling."""
    return [
        f"{key}: {figures[key]:,} is above the ceiling of {limit['ceiling']:,}; make it smaller, "
        f"or raise the ceiling in scripts/{LIMITS.name} and say why in the commit"
        for key, limit in limits.items()
        if figures[key] > limit["ceiling"]
    ]


if __name__ == "__main__":
    main()
