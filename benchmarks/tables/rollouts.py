"""The two ways to fit HuMoR, beside each other: lines of a table from rows of windows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.tables.values import markdown, result, source

METHODS = ("collocation", "rollout", "shooting")
ACROBATIC = "49"
"""Subject whose recordings are acrobatics: jumps, handsprings, cartwheels."""
FILES = (
    "rollout_fits", "rollout_fits_hidden", "rollout_gap", "rollout_half", "rollout_camera",
    "rollout_views", "rollout_depth",
)  # fmt: skip
HEADINGS = ["on the same windows", "method", "joints cm", "unseen cm", "by thirds cm",
            "network's own cm", "CPU s", "by tolerance"]  # fmt: skip
_TOLERANCE = ("converged", "gradient")


def rollout_fits() -> str:
    """Roll-out and collocation in every protocol that was run."""
    found = [result(file) for file in FILES]
    shown = [line for one in found for line in lines(one["rows"], one["network"])]
    return markdown(HEADINGS, shown) + source(*FILES)


def lines(rows: Sequence[Mapping[str, Any]], known: Mapping[str, float]) -> list[list[str]]:
    """Means over windows by protocol and method, those of acrobatics apart.

    Args:
        rows: what a method did with a window, metres; see `benchmarks.rollout_fits.Row`.
        known: by window, the error that is left when the true motion is encoded and rolled out.
    """
    found: list[list[str]] = []
    for protocol in dict.fromkeys(row["protocol"] for row in rows):
        for acrobatic in (False, True):
            for method in METHODS:
                own = [
                    row for row in rows
                    if (row["protocol"], row["method"], row["subject"] == ACROBATIC)
                    == (protocol, method, acrobatic)
                ]  # fmt: skip
                if own:
                    kind = ", acrobatics" if acrobatic else ""
                    count = f"{len(own)} window{'s' if len(own) > 1 else ''}"
                    found.append([f"{protocol}{kind}, {count}", method, *_cells(own, known)])
    return found


def _cells(rows: Sequence[Mapping[str, Any]], known: Mapping[str, float]) -> list[str]:
    """Columns of some windows of one method."""
    hidden = [row["hidden"] for row in rows if row["hidden"] is not None]
    thirds = np.mean([row["thirds"] for row in rows], 0)
    ended = sum(row["ended"] in _TOLERANCE for row in rows)
    return [
        f"{100 * np.mean([row['joints'] for row in rows]):.2f}",
        f"{100 * np.mean(hidden):.2f}" if hidden else "–",
        " ".join(f"{100 * third:.2f}" for third in thirds),
        f"{100 * np.mean([known[row['window']] for row in rows]):.1f}",
        f"{np.mean([row['seconds'] for row in rows]):.1f}",
        f"{ended} of {len(rows)}",
    ]
