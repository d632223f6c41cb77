"""Tables of films of phones."""

from benchmarks.tables.values import markdown, number, result, source

_FOCAL = {
    "known": "known", "found": "guessed and found by the fit", "held": "guessed and held",
}  # fmt: skip


def focal() -> str:
    """The focal length told, found and guessed; windows of validation subjects."""
    rows = []
    for name, label in _FOCAL.items():
        found = result("phone")["tables"]["focal"][name]
        ratios = [row["ratio"] for row in found.values() if "ratio" in row]
        rows.append([
            label, number(found["mean"]["about"], 100, 2),
            f"{min(ratios):.2f} to {max(ratios):.2f}", number(found["mean"]["seconds"], 1, 1),
        ])  # fmt: skip
    headings = ["focal length", "about the pelvis cm", "over the true one", "CPU s"]
    return markdown(headings, rows) + source("phone")
