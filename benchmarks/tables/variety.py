"""Variations of HuMoR's training windows, compared on people whom they never saw."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.strangers import compare
from benchmarks.strangers.compare import Rows
from benchmarks.strangers.fits import HUMOR, POSE
from benchmarks.tables.strangers import estimate_cell, folds_of
from benchmarks.tables.values import markdown, number, present, result, source

HEADINGS = ["fold", "learned from", "noisy joints", "legs of noisy joints", "hidden points",
            "gap of 1 s", "runs, hidden legs", "contacts", "drift, cm"]  # fmt: skip
BASE = "base"
_COLUMNS = (
    ("noisy joints", "error"),
    ("noisy joints", "legs"),
    ("hidden points", "error"),
    ("gap", "error"),
    ("hidden legs", "error"),
)
_VARIED = ("strangers_varied", "strangers_varied_more")
"""Result files of folds with all variations."""
_LATER = (
    "*To be measured: `python -m benchmarks.strangers.variety CORPUS FOLDS --json variety.json`.*"
)
_FOLDS_LATER = "*To be measured: `python -m benchmarks.strangers CORPUS FOLDS --only 60 02`.*"


def variety() -> str:
    """Every variation against the pose prior and, on the same windows, against no edits."""
    if not present(["variety"]):
        return _LATER
    file = result("variety")
    said = "; ".join(f"{name}: {_told(own)}" for name, own in file["settings"].items())
    if file["continued"] > 0:
        said += f"; each went on from the weights without edits for {file['continued']} steps"
    return f"{markdown(HEADINGS, lines(file['variants']))}\n\n{said}.{source('variety')}"


def from_scratch() -> str:
    """Folds trained from scratch with all variations, against those trained without."""
    if not present(["strangers", *_VARIED]):
        return _FOLDS_LATER
    plain, varied = result("strangers")["folds"], folds_of(_VARIED)
    base = {fold: own for fold, own in plain.items() if fold in varied}
    varied = {fold: own for fold, own in varied.items() if fold in base}
    table = markdown(HEADINGS, lines({BASE: base, "all": varied}))
    return table + source("strangers", *_VARIED)


def lines(found: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[list[str]]:
    """Lines of every fold, and of their mean where a variation has several.

    Args:
        found: entries of `benchmarks.strangers.variety.measured`, by variation and fold.
    """
    folds = list(found[BASE])
    made = [line for fold in folds for line in _lines(found, [fold], fold)]
    if len(folds) > 1:
        shared = [f for f in folds if all(f in own for own in found.values())]
        if len(shared) > 1:
            made += _lines(found, shared, f"**mean of {len(shared)}**")
    return made


def _lines(
    found: Mapping[str, Mapping[str, Mapping[str, Any]]], folds: Sequence[str], title: str
) -> Iterator[list[str]]:
    for name, own in found.items():
        if any(fold not in own for fold in folds):
            continue
        drifts = [own[fold]["drift"] for fold in folds]
        drift = None if None in drifts else sum(drifts) / len(drifts)
        pairs = [(found[BASE][fold]["rows"], own[fold]["rows"]) for fold in folds]
        cells = _cells([against_pose(*pair) for pair in pairs])
        yield [title, f"{name} / pose prior", *cells, number(drift, 100)]
        if name != BASE:
            yield [title, f"{name} / {BASE}", *_cells([against_base(*p) for p in pairs]), ""]


def against_pose(base: Rows, variation: Rows) -> Rows:
    """Rows by the pose prior, which are kept with the base, and by HuMoR of a variation."""
    return [r for r in base if r["method"] == POSE] + [
        r for r in variation if r["method"] == HUMOR
    ]


def against_base(base: Rows, variation: Rows) -> Rows:
    """Rows by HuMoR without edits in the place of the pose prior's, and by that of a variation."""
    before = [{**r, "method": POSE} for r in base if r["method"] == HUMOR]
    return before + [r for r in variation if r["method"] == HUMOR]


def _cells(folds: Sequence[Rows]) -> Iterator[str]:
    for protocol, field in _COLUMNS:
        sums = [compare.ratio(rows, protocol, field) for rows in folds]
        yield estimate_cell(sums, compare.quotient)
    sums = [compare.contacts(rows, "noisy joints") for rows in folds]
    yield estimate_cell(sums, compare.more_balanced, factor=100, digits=1)


def _told(settings: Mapping[str, float]) -> str:
    """Settings other than mirror, reverse, speed and shape, which all have in common."""
    usual = ("mirror", "reverse", "speed", "shape")
    parts = [f"{k} {v:g}" for k, v in settings.items() if k not in usual and v != 0]
    return ", ".join(parts) or "no edits"
