"""Sheds are leaves: whoever deletes one still fits, asks for help, and imports all the rest."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.without_sheds import SHEDS

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def failures() -> dict[str, dict[str, str]]:
    if not hasattr(os, "fork"):
        pytest.skip("needs fork")
    done = subprocess.run(
        [sys.executable, "-m", "tests.without_sheds"], cwd=ROOT, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


WHERE = [(shed, part) for shed in SHEDS for part in ("fit", "help", "modules")]


@pytest.mark.parametrize(("shed", "part"), WHERE)
def test_the_rest_works_without_a_shed(failures, shed, part):
    assert failures[shed].get(part) is None


def test_the_contract_of_imports_has_every_shed_above_the_rest():
    with (ROOT / "pyproject.toml").open("rb") as file:
        (contract,) = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    assert contract["layers"][0] == "training"
    assert set(contract["layers"][1].split(" | ")) == {f"recon.{shed}" for shed in SHEDS}
