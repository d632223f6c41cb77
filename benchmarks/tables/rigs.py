"""Tables of rigs of which one camera is out of step and out of its calibration."""

from collections.abc import Sequence

from benchmarks.tables.values import NONE, markdown, number, result, source

_FITS = {
    "clean": "as it should be", "as it is": "80 ms and 1 degree off in one view",
    "put right": "the same, put right",
}  # fmt: skip


def found() -> str:
    """Clocks and turns of one of three cameras, found; windows of validation subjects."""
    rows: list[list[str]] = []
    for name, row in result("rigs")["found"].items():
        count = len(row["windows"])
        rows.append([
            name, f"{row['right']} of {count}", str(row["wrong"]), str(row["said"]),
            _pair(row["clock"], 1000, 1), _pair(row["turn"], 1, 2), number(row["seconds"], 1, 1),
        ])  # fmt: skip
    headings = [
        "one camera is off by", "right view corrected", "wrong view", "said instead",
        "clock off by ms", "turned by degrees", "CPU s",
    ]  # fmt: skip
    return markdown(headings, rows) + source("rigs")


def fits() -> str:
    """Joints of fits to a rig before and after it is put right."""
    every = result("rigs_fit")["fits"]
    rows = [
        [label, number(every[name]["mean"], 100, 2), number(max(every[name]["windows"]), 100, 2)]
        for name, label in _FITS.items()
    ]
    return markdown(["rig", "joints cm", "worst window cm"], rows) + source("rigs_fit")


def _pair(errors: Sequence[float] | None, factor: float, digits: int) -> str:
    """Median and largest error."""
    if errors is None:
        return NONE
    return f"{number(errors[0], factor, digits)}, at most {number(errors[1], factor, digits)}"
