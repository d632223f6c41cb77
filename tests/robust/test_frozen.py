"""The comparison of frozen results tells what moved, and by how much it may."""

from pathlib import Path

import numpy as np
import pytest

from scripts.frozen.__main__ import differences

KEPT = {
    "joints": np.zeros((3, 22, 3)),
    "objective": np.array(2.0),
    "contacts": np.zeros((3, 22)),
    "words": np.array(["ROOT pelvis", "{"]),
    "numbers": np.array([1000.0, np.nan]),
}


@pytest.mark.parametrize(
    ("change", "tolerance", "words"),
    [
        ({}, 1e-4, ""),
        ({"joints": KEPT["joints"] + 9e-5}, 1e-4, ""),
        ({"joints": KEPT["joints"] + 2e-4}, 1e-4, "joints moved"),
        ({"joints": KEPT["joints"] + 2e-4}, 1e-3, ""),
        ({"joints": KEPT["joints"] * np.nan}, 1e-3, "joints moved"),
        ({"joints": KEPT["joints"][:2]}, 1e-3, "shape (3, 22, 3) became (2, 22, 3)"),
        ({"objective": np.array(2.001)}, 1e-4, ""),
        ({"objective": np.array(2.003)}, 1e-4, "the objective rose"),
        ({"objective": np.array(1.0)}, 1e-4, ""),
        ({"objective": np.array(np.nan)}, 1e-4, "the objective rose"),
        ({"contacts": np.eye(3, 22)}, 1e-4, "contacts changed"),
        ({"words": np.array(["ROOT hips", "{"])}, 1e-4, "'ROOT pelvis' to 'ROOT hips'"),
        ({"numbers": np.array([1002.0, np.nan])}, 1e-4, "numbers moved by up to 2"),
        ({"numbers": np.array([1000.0, 0.0])}, 1e-4, "numbers moved"),
        ({"more": np.zeros(2)}, 1e-4, "more is new"),
    ],
)
def test_what_moved_is_told(tmp_path: Path, change: dict, tolerance: float, words: str) -> None:
    np.savez(tmp_path / "a.npz", **KEPT)
    np.savez(tmp_path / "b.npz", **(KEPT | change))
    found = "; ".join(differences(tmp_path / "a.npz", tmp_path / "b.npz", tolerance).words)
    assert words in found
    assert bool(words) == bool(found)
