"""Tables of the network that says what a point of a cloud shows."""

from collections.abc import Mapping

from benchmarks.tables.values import markdown, number, result, source


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
