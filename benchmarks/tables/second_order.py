"""Fits of today beside those of version 0.1.0, window by window."""

from collections.abc import Mapping

from benchmarks.tables.values import markdown, number, result, source

_ROWS: tuple[tuple[str, str, float, int], ...] = (
    ("CPU, ratio", "CPU time, ratio", 1.0, 2),
    ("CPU s of 0.1.0", "CPU s of 0.1.0", 1.0, 1),
    ("CPU s", "CPU s", 1.0, 1),
    ("objective, ratio", "objective of 0.1.0's last stage, ratio", 1.0, 4),
    ("windows with an objective not above 0.1.0's", "windows in which it is not above, %", 100, 0),
    ("joints, ratio", "error of joints, ratio", 1.0, 3),
    ("vertices, ratio", "error of vertices, ratio", 1.0, 3),
    ("all points, ratio", "error of all points, ratio", 1.0, 3),
    ("hidden points, ratio", "error of hidden points, ratio", 1.0, 3),
    ("by tolerance, in the stage with the fewest", "windows that end by tolerance, %", 100, 0),
    ("moved by tighter tolerances, mm", "moved by ten times tighter tolerances, mm", 1.0, 2),
    ("hidden moved, mm", "of these, hidden points, mm", 1.0, 2),
)


def converged() -> str:
    """Ratios to version 0.1.0 by protocol, and the time of an evaluation."""
    found = result("converged")
    protocols: Mapping[str, Mapping[str, float]] = found["summary"]
    rows = [
        [title, *(number(own.get(name), factor, digits) for own in protocols.values())]
        for name, title, factor, digits in _ROWS
    ]
    counts = [str(sum(row["protocol"] == name for row in found["rows"])) for name in protocols]
    table = markdown(["", *protocols], [["windows", *counts], *rows])
    evaluation = [[name, number(value, 1.0, 2)] for name, value in found["evaluation"].items()]
    products = markdown(["one evaluation of the last stage", ""], evaluation)
    return f"{table}\n\n{products}" + source("converged")
