"""Tables of clouds: the network that says what a point shows, and fits of what depth shows."""

from collections.abc import Mapping
from typing import Any

from benchmarks.tables.values import markdown, number, present, result, source, spread
from recon.benchmark.table import interval, paired


def labels() -> str:
    """Points of simulated clouds that are labelled rightly, by kind of person and of cloud."""
    found = result("labels")
    rows = [
        [name, _spread(means["accuracy"], 0), _spread(means["but for sides"], 0),
         _spread(means["place_median_cm"], 1), number(means["covered"]["mean"], 1, 0),
         number(means["stray"]["mean"], 1, 1)]
        for name, row in found["rows"].items()
        if (means := row["means"])
    ]  # fmt: skip
    headings = [
        "person, cloud", "right, %", "but for sides, %", "place, median cm", "within 2 std, %",
        "on a body, %",
    ]  # fmt: skip
    return markdown(headings, rows) + source("labels")


def _spread(estimate: Mapping[str, float], digits: int) -> str:
    middle, low, high = (f"{estimate[k]:.{digits}f}" for k in ("mean", "low", "high"))
    return f"{middle} [{low}, {high}]"


_NAMES = {
    "depth": "depth, sensor known",
    "depth, MakeHuman": "depth, sensor known, MakeHuman's people",
    "depth, sensor unknown": "depth, sensor unknown",
    "2D": "2D of the sensor, unknown", "2D + depth": "2D + depth, sensor unknown",
    "joints": "joints", "joints + depth": "joints + depth, sensor known",
}  # fmt: skip
_COLUMNS = {
    "root_visible": ("visible cm", 100, 1), "root_hidden": ("hidden cm", 100, 1),
    "root_all": ("all cm", 100, 1), "vertices_visible": ("vertices seen cm", 100, 1),
    "vertices": ("vertices cm", 100, 1), "surface": ("surface cm", 100, 1),
    "covered_visible": ("within std, seen", 1, 2), "covered_hidden": ("hidden", 1, 2),
    "wrong": ("windows wrong %", 100, 0),
    "first": ("first guess cm", 100, 1), "normal": ("normal °", 1, 1),
    "height": ("height cm", 100, 1), "first_seconds": ("first CPU s", 1, 1),
    "seconds": ("CPU s", 1, 1),
}  # fmt: skip
_ALONE = {
    "2D + depth": ("2D", "depth, sensor unknown"),
    "joints + depth": ("joints", "depth"),
}
"""Mixtures, and the cases of their parts."""
_ERRORS = ("root_visible", "root_hidden", "root_all", "vertices_visible", "vertices")
_WRONG = 0.1
"""Mean error of joints about the pelvis, metres, from which on a fit should say something."""


_FILES = ("clouds", "clouds_people", "clouds_mixed", "clouds_before")
"""Result files: clouds alone, of other people, other cases, and version 0.1.0. A window that
several have is taken from the first."""


def _clouds() -> dict[str, Any]:
    """The result files as one, without windows whose files were refused."""
    found = [result(name) for name in present(_FILES)]
    subject: dict[str, str] = {}
    values: dict[str, dict[str, dict[str, Any]]] = {}
    for one in reversed(found):
        subject |= dict(zip(one["names"], one["subjects"], strict=True))
        for case, methods in one["values"].items():
            for method, windows in methods.items():
                values.setdefault(case, {}).setdefault(method, {}).update(windows)
    for methods in values.values():
        for method, windows in methods.items():
            methods[method] = {k: row for k, row in windows.items() if "refused" not in row}
    merged = {"names": list(subject), "subjects": list(subject.values())}
    ordered = {case: values[case] for case in _NAMES if case in values}
    return {**found[0], **merged, "values": ordered}


def depth() -> str:
    """Depth alone and with other sensors, by version: means over subjects."""
    found = _clouds()
    rows = [
        [f"{_NAMES[case]}: {method}", str(len(values)), *(
            number(_mean(found, values, metric), factor, digits)
            for metric, (_, factor, digits) in _COLUMNS.items()
        )]
        for case, methods in found["values"].items()
        for method, values in methods.items()
    ]  # fmt: skip
    headings = ["case", "windows", *(heading for heading, _, _ in _COLUMNS.values())]
    return markdown(headings, rows) + source(*present(_FILES))


def depth_compared() -> str:
    """Paired differences: this version less 0.1.0, and mixtures less the better of their parts."""
    found = _clouds()
    rows: list[list[str]] = []
    for case, methods in found["values"].items():
        if "0.1.0" in methods:
            rows.append([f"{_NAMES[case]}: less 0.1.0",
                         *_differences(found, methods["recon"], methods["0.1.0"])])  # fmt: skip
        rows += [
            [f"{_NAMES[case]}: less {_NAMES[part]}",
             *_differences(found, methods["recon"], found["values"][part]["recon"])]
            for part in _ALONE.get(case, ())
            if part in found["values"]
        ]  # fmt: skip
    headings = ["cm, with 95 % intervals", *(_COLUMNS[metric][0] for metric in _ERRORS)]
    return markdown([h.removesuffix(" cm") for h in headings], rows) + source(*present(_FILES))


def depth_by_subject() -> str:
    """Joints about the pelvis, by subject: means over all frames."""
    found = _clouds()
    subject = dict(zip(found["names"], found["subjects"], strict=True))
    people = sorted(set(subject.values()))
    rows = []
    for case, methods in found["values"].items():
        for method, values in methods.items():
            own = {p: [one["root_all"] for name, one in values.items() if subject[name] == p]
                   for p in people}  # fmt: skip
            cells = [number(sum(v) / len(v) if v else None, 100, 1) for v in own.values()]
            rows.append([f"{_NAMES[case]}: {method}", *cells])
    return markdown(["all joints, cm", *people], rows) + source(*present(_FILES))


def depth_warned() -> str:
    """Fits of clouds that are far off and say nothing, and right ones that warn."""
    found = _clouds()
    rows = [_warned(method, found["values"], method) for method in ("recon", "0.1.0")]
    turned = present(("clouds_turned",))
    rows += [_warned("recon, begun turned round", result(name)["values"], "turned")
             for name in turned]  # fmt: skip
    headings = ["version", "fits more than 10 cm off", "of them silent", "other fits",
                "of them with a warning"]  # fmt: skip
    return markdown(headings, rows) + source(*present(_FILES), *turned)


def _warned(name: str, values: Mapping[str, Any], method: str) -> list[str]:
    """One row: all fits of clouds of a method."""
    every = [
        one
        for case, methods in values.items()
        if "depth" in case
        for one in methods.get(method, {}).values()
    ]
    far = [bool(one["said"]) for one in every if one["root_all"] > _WRONG]
    near = [bool(one["said"]) for one in every if one["root_all"] <= _WRONG]
    return [name, f"{len(far)}", f"{far.count(False)}", f"{len(near)}", f"{near.count(True)}"]


def _mean(found: Mapping[str, Any], values: Mapping[str, Any], metric: str) -> float | None:
    kept = _counted(found, values)
    if all(values[name].get(metric) is None for name in kept):
        return None
    return interval([values[name].get(metric) for name in kept], *_groups(found, kept)).mean


def _differences(
    found: Mapping[str, Any], ours: Mapping[str, Any], theirs: Mapping[str, Any]
) -> list[str]:
    both = [name for name in _counted(found, ours) if name in theirs]
    return [
        spread(paired(
            [ours[name][metric] for name in both], [theirs[name][metric] for name in both],
            *_groups(found, both),
        ), 100, 1)
        for metric in _ERRORS
    ]  # fmt: skip


def _counted(found: Mapping[str, Any], values: Mapping[str, Any]) -> list[str]:
    """Windows of subjects who count in means."""
    subject = dict(zip(found["names"], found["subjects"], strict=True))
    return [name for name in values if name in subject and subject[name] not in found["apart"]]


def _groups(found: Mapping[str, Any], names: list[str]) -> tuple[list[str], list[str]]:
    """Clips and subjects of windows."""
    subject = dict(zip(found["names"], found["subjects"], strict=True))
    return [name.rsplit("@", 1)[0] for name in names], [subject[name] for name in names]
