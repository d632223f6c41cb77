"""Every benchmark can be imported; no other test looks at most of them."""

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "benchmarks").rglob("*.py")
    if path.stem not in ("__main__", "fitter")  # fitter runs inside version 0.1.0
)


@pytest.mark.parametrize("name", MODULES)
def test_it_names_nothing_that_is_gone(name):
    """A benchmark asked for a function that had been renamed."""
    importlib.import_module(name)
