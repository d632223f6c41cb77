"""Damaged files: refused by name, or read to numbers within `recon.core.limits`; nothing else."""

import warnings
from collections import Counter
from pathlib import Path

import pytest

from benchmarks.fuzz_readers import is_whole, mutant, outcome, written
from benchmarks.fuzz_seeds import Seed, seeds


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> list[Seed]:
    return seeds(tmp_path_factory.mktemp("seeds"), None)


def test_seeds_are_whole(found: list[Seed], tmp_path: Path) -> None:
    assert all(is_whole(one, tmp_path) for one in found)
    assert len({one.kind for one in found}) >= 11


def test_three_hundred_damaged_files(found: list[Seed], tmp_path: Path) -> None:
    """Damage is refused, or what is read is plausible: a test that took either for good saw none
    of the nonsense that was accepted."""
    outcomes: Counter[str] = Counter()
    for number in range(300):
        one, data, how = mutant(found, number, seed=7)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            became = outcome(one, written(one, data, tmp_path))
        assert became in ("refused", "read"), f"mutant {number} of {one.name} ({how}): {became}"
        outcomes[became] += 1
    assert outcomes["refused"] > 150
    assert outcomes["read"] > 5


def test_what_is_implausible_is_found(found: list[Seed], tmp_path: Path) -> None:
    """The judge itself: a reader that accepts anything is caught."""
    one = next(seed for seed in found if seed.kind == "joints3d")
    record = one.read(written(one, one.data, tmp_path))
    record.positions[0, 0] = 1e30  # type: ignore[attr-defined]
    lax = Seed(one.kind, one.name, one.data, lambda _: record)
    assert outcome(lax, tmp_path / one.name).startswith("read something implausible")
    broken = Seed(one.kind, one.name, one.data, lambda _: {}["no key"])
    assert outcome(broken, tmp_path / one.name).startswith("traceback")
