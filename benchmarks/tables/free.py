"""Freely licensed recordings: what each is used for, and how much there is to learn from."""

from benchmarks.tables.values import markdown, number, result, source

_WORDS = {
    "train": "trains",
    "validation": "validates",
    "test": "only tested",
    "none": "unused",
}


def recordings() -> str:
    """Every free recording beside the main folders of CMU's collection."""
    rows = [
        [row["path"].split("/", 1)[1], row["person"], row["motion"], row["licence"],
         *(number(row.get(key)) for key in ("seconds", "residual_mm", "falls")),
         f"{_WORDS[row['use']]}: {row['why']}"]
        for row in result("free_recordings")["recordings"]
    ]  # fmt: skip
    headings = ["recording", "person", "motion", "licence", "s", "residual mm",
                "falls at m/s²", "used, and why"]  # fmt: skip
    return markdown(headings, rows) + source("free_recordings")


def counts() -> str:
    """Clips, people and minutes of the open corpus, without these recordings and with them."""
    found = result("free_recordings")["counts"]
    names = {"train": "training", "validation": "validation"}
    rows = [
        [f"{names[part]}, {label} them", f"{row['clips']:.0f}", f"{row['people']:.0f}",
         *(number(row[key], 1, 2) for key in
           ("minutes", "minutes on flat ground", "minutes with contacts"))]
        for part in names
        for label, row in ((label, found[label][part]) for label in ("without", "with"))
    ]  # fmt: skip
    headings = ["part", "clips", "known people", "minutes", "on flat ground",
                "of which with contacts"]  # fmt: skip
    return markdown(headings, rows) + source("free_recordings")
