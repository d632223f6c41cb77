"""The library knows no sensor and no prior by its class or name outside of their rooms."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = sorted((ROOT / "recon").rglob("*.py"))
SENSORS = {"Joints3D", "Markers3D", "Keypoints2D", "PointCloud"}
MAKERS = ("simulation/", "ingest/", "reading/", "fitting/gait.py", "benchmark/protocols.py")
"""Places that make observations, from motions or recordings, and so call their classes."""
VERBS = {
    "recon/api/generate.py",
    "recon/api/interpolate.py", "recon/api/retarget.py",
    "recon/cli/making.py",
    "recon/fitting/recording.py", "recon/fitting/interpolation.py",
    "recon/fitting/retargeting.py", "recon/api/demo.py",
    "training/labels/shards.py",
}  # fmt: skip
"""Files about what one prior alone can do: training it, drawing from it, changing bodies."""
TOOLS = {
    "recon/live/beginning.py", "recon/live/tracking.py", "recon/live/objective.py",
    "recon/live/stream.py", "recon/diagnosis/quick_fit.py", "recon/fitting/retargeting.py",
    "recon/ingest/marker_poses.py",
}  # fmt: skip
"""Files that use the pose prior for a step of their own, not for the fit that was asked for."""
BENCH = {"recon/benchmark/methods.py"}
"""Files that judge priors by name, on windows of people from whom none of them learned."""
DEFAULTS = {
    "recon/api/fit.py", "recon/api/refine.py", "recon/batch/clips.py", "recon/people/together.py",
    "recon/fitting/settings.py",
    "recon/fitting/methods.py",
}  # fmt: skip
"""Files with the default argument."""


def _annotations(tree: ast.AST) -> set[int]:
    """All nodes inside annotations, and inside aliases of types (`A = B | C`)."""
    found: list[ast.AST] = []
    for node in ast.walk(tree):
        match node:
            case ast.arg(annotation=ast.AST() as hint) | ast.AnnAssign(annotation=hint):
                found.append(hint)
            case ast.FunctionDef(returns=ast.AST() as hint):
                found.append(hint)
            case ast.Assign(value=ast.BinOp(op=ast.BitOr()) as union):
                found.append(union)
            case _:
                pass
    return {id(inside) for hint in found for inside in ast.walk(hint)}


@pytest.mark.parametrize("path", LIBRARY, ids=lambda path: str(path.relative_to(ROOT)))
def test_sensors_are_asked_and_not_told_apart(path):
    """A fifth sensor once met 23 tests of its class."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    told = _annotations(tree)
    made = {
        id(node.func)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and path.relative_to(ROOT / "recon").as_posix().startswith(MAKERS)
    }
    for node in ast.walk(tree):
        name = getattr(node, "id", None) or getattr(node, "attr", None)
        if name in SENSORS and path != ROOT / "recon" / "__init__.py":
            assert id(node) in told | made, f"{path}:{getattr(node, 'lineno', 0)}: {name}"


def _entry_points() -> dict[str, str]:
    with (ROOT / "pyproject.toml").open("rb") as file:
        return tomllib.load(file)["project"]["entry-points"]["recon.priors"]


def _priors_in(path: Path) -> set[str]:
    """Imports of priors and their names as texts; `pose` and `recording` name many things."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = set(_entry_points()) - {"pose", "recording"}
    found: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.ImportFrom(module=str(module)) if re.match(r"priors\.", module):
                found |= set() if module == "priors.checkpoints" else {module}
            case ast.Constant(value=str(text)) if text in names:
                found.add(text)
            case ast.Compare(left=ast.Attribute(attr="prior"), comparators=[ast.Constant()]):
                found.add(ast.unparse(node))
            case _:
                pass
    return found


@pytest.mark.parametrize("path", LIBRARY, ids=lambda path: str(path.relative_to(ROOT)))
def test_priors_are_asked_and_not_told_apart(path):
    """A fourth prior had to be written into eight places."""
    place, found = path.relative_to(ROOT).as_posix(), _priors_in(path)
    if place in DEFAULTS:
        assert found <= {"humor"}
    elif place not in VERBS | TOOLS | BENCH:
        assert found == set(), f"{place} knows {found}"


def test_exceptions_are_still_needed():
    for place in VERBS | TOOLS | BENCH | DEFAULTS:
        assert _priors_in(ROOT / place), f"{place} is free of priors: take it off the list"


@pytest.mark.parametrize(("name", "place"), _entry_points().items())
def test_registered_priors_are_there(name, place):
    module, _, kind = place.partition(":")
    text = (ROOT / Path(*module.split("."))).with_suffix(".py").read_text(encoding="utf-8")
    assert f"class {kind}" in text, name
