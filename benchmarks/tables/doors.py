"""Tables of what other programs' files and projects give."""

from benchmarks.tables.values import markdown, number, result, source


def files() -> str:
    """Every file of 3D keypoints."""
    rows = [
        [name, number(row["joints"], 100, 2), number(row["legs"], 100, 2),
         number(row["warnings"], 1, 0), number(row["seconds"], 1, 1)]
        for name, row in result("doors")["files"].items()
    ]  # fmt: skip
    headings = ["file", "joints cm", "knees to toes cm", "findings", "CPU s"]
    return markdown(headings, rows) + source("doors")


def projects() -> str:
    """Every project folder."""
    rows = [
        [name, number(row["frames"], 1, 0), number(row["reprojection"], 1, 1),
         number(row["away"], 100, 1), number(row["seconds"], 1, 1)]
        for name, row in result("doors")["projects"].items()
    ]  # fmt: skip
    headings = ["project", "frames", "body px", "3D table against 2D cm", "CPU s"]
    return markdown(headings, rows) + source("doors")
