"""The table of conversions, beside version 0.1.0."""

from collections.abc import Sequence
from typing import Any

from benchmarks.tables.values import NONE, markdown, number, result, source

_VERSIONS = ("baseline", "ours")


def convert() -> str:
    """CPU seconds, residuals, left-out markers and unmade steps of both versions."""
    found = result("convert")
    markers, skeletons = found["rows"], found["skeletons"]
    rows = [_cells(name, row) for name, row in sorted(markers.items())]
    rows.append(_cells(f"**{len(markers)} of markers**", _together(list(markers.values()))))
    rows += [_cells(name, row) for name, row in skeletons.items()]
    headings = [
        "recording", "s", "CPU s, 0.1.0", "now", "ratio", "with imports", "residual mm, 0.1.0",
        "now", "left out mm, 0.1.0", "now", "unmade steps, 0.1.0", "now",
    ]  # fmt: skip
    return markdown(headings, rows) + source("convert")


def _cells(name: str, row: dict[str, Any]) -> list[str]:
    both = [row[version] for version in _VERSIONS]
    return [
        name.removeprefix("mocap/"),
        number(row["seconds"]),
        *(number(one["work"], 1, 2) for one in both),
        *(number(row[key], 1, 2) for key in ("work_ratio", "process_ratio")),
        *(number(one["residual_mm"], 1, 2) for one in both),
        *(number(one.get("left_out_mm"), 1, 2) for one in both),
        *(str(one["unmade"]) if "unmade" in one else NONE for one in both),
    ]


def _together(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sums of times and steps, means of errors over recordings."""
    found: dict[str, Any] = {"seconds": sum(row["seconds"] for row in rows)}
    for version in _VERSIONS:
        runs = [row[version] for row in rows]
        found[version] = {key: sum(run[key] for run in runs) for key in ("work", "process")}
        found[version]["unmade"] = sum(run["unmade"] for run in runs)
        for key in ("residual_mm", "left_out_mm"):
            values = [run[key] for run in runs if key in run]
            found[version][key] = sum(values) / len(values)
    for key in ("work", "process"):
        found[f"{key}_ratio"] = found["ours"][key] / found["baseline"][key]
    return found
