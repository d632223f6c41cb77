"""Tables of laboratories' recordings: what is read, left-out markers, gaps."""

from typing import Any

import numpy as np

from benchmarks.tables.values import markdown, number, result, source

_KEYS = ("residual_mm", "left_out_mm", "gaps_mm", "fit_gaps_mm", "arm_degrees")
_LONGEST = 150
"""Characters of a refusal that are shown."""


def recordings() -> str:
    """Every recording of whole bodies, and the median over all."""
    found = result("clinic")["recordings"]
    rows = [
        [name, str(row["frames"]), *(number(row.get(key)) for key in _KEYS), str(row["invented"])]
        for name, row in found.items()
    ]
    rows.append([f"**median of {len(rows)}**", "", *_medians(list(found.values())), ""])
    headings = [
        "recording", "frames", "residual mm", "left out mm", "gaps mm", "gaps by fit mm",
        "arm without markers °", "invented frames",
    ]  # fmt: skip
    return markdown(headings, rows) + source("clinic")


def files() -> str:
    """Every file of other vendors: what it becomes, or why it is refused."""
    rows = [[name.removeprefix("vendors/"), *_read(row)]
            for name, row in result("clinic")["vendors"].items()]  # fmt: skip
    headings = ["file", "frames", "begins at s", "residual mm", "refused, or not seen", "CPU s"]
    lines = markdown(headings, rows).split("\n")
    lines[1] = "| --- | --: | --: | --: | --- | --: |"
    return "\n".join(lines) + source("clinic")


def _medians(rows: list[dict[str, Any]]) -> list[str]:
    values = [[row[key] for row in rows if row.get(key) is not None] for key in _KEYS]
    return [number(float(np.median(some))) if some else "" for some in values]


def _read(row: dict[str, Any]) -> list[str]:
    if "refused" in row:
        reason = row["refused"].split("; labels not known")[0].replace("|", " ")
        reason = reason.partition(": ")[2] or reason
        more = " ..." if len(reason) > _LONGEST else ""
        return ["", "", "", f"refused: {reason[:_LONGEST]}{more}", number(row["refusal"], 1, 2)]
    unseen = "; ".join(row["unseen"]).partition(" (frames")[0].replace("no marker shows ", "")
    return [
        str(row["frames"]), number(row["start"], 1, 2), number(row["residual_mm"]), unseen,
        number(row["seconds"], 1, 2),
    ]  # fmt: skip
