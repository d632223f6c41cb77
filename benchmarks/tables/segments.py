"""Multiple shooting with segments of several lengths: lines of a table from rows of windows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.tables.values import markdown, number, present, result, source

HEADINGS = ["on the same windows", "method", "joints cm", "by thirds cm",
            "hidden points cm", "objective", "defect, nats", "drift cm", "evaluations", "CPU s",
            "by tolerance"]  # fmt: skip
FILES = ("segments", "segments_ends", "segments_hidden", "segments_hidden_1", "segments_hidden_15",
         "segments_hidden_rollout")  # fmt: skip
_ORDER = ("collocation", "segments of 1", "segments of 5", "segments of 15", "roll-out")
_TOLERANCE = ("converged", "gradient")


def segments() -> str:
    """Every length in every protocol."""
    files = present(FILES)
    rows = [row for file in files for row in result(file)["rows"]]
    return markdown(HEADINGS, lines(rows)) + source(*files)


def lines(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Means over windows by protocol and length; see `benchmarks.segments.Row`."""
    found: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault((row["protocol"], row["method"]), []).append(row)
    protocols = list(dict.fromkeys(protocol for protocol, _ in found))
    return [
        _line(protocol, method, found[protocol, method])
        for protocol in protocols
        for method in _ORDER
        if (protocol, method) in found
    ]


def _line(protocol: str, method: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    def mean(name: str) -> float | None:
        values = [row[name] for row in rows if row[name] is not None]
        return float(np.mean(values)) if values else None

    thirds = np.mean([row["thirds"] for row in rows], 0)
    ended = sum(row["ended"] in _TOLERANCE for row in rows)
    return [
        f"{protocol}, {len(rows)} windows",
        method,
        number(mean("joints"), 100, 2),
        " ".join(f"{100 * third:.2f}" for third in thirds),
        number(mean("hidden"), 100, 2),
        number(mean("objective"), 1, 0),
        number(mean("defect"), 1, 1),
        number(mean("drift"), 100, 1),
        number(mean("evaluations"), 1, 0),
        number(mean("seconds"), 1, 1),
        f"{ended} of {len(rows)}",
    ]
