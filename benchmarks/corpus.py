"""What became of the training corpus: clips, residuals, foot slip.

    recon convert --all MOCAP CORPUS
    python -m benchmarks.corpus CORPUS --json corpus.json

Reads the report that the conversion wrote.
"""

import argparse
import csv
from collections import Counter, defaultdict
from pathlib import Path
from statistics import mean, median

from rich.console import Console
from rich.table import Table

from benchmarks.results import corpus_source, write

Row = dict[str, str]


def main() -> None:
    """Read, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    with (arguments.corpus / "report.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    groups: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        groups[row["collection"]].append(row)
    groups["all"] = rows
    summary = {name: summarise(group) for name, group in groups.items()}
    reasons = Counter(row["reason"] for row in rows if row["kept"] != "True")
    table = Table("collection", *next(iter(summary.values())), title="corpus conversion")
    for name, values in summary.items():
        table.add_row(name, *(f"{value:.4g}" for value in values.values()))
    console = Console()
    console.print(table)
    for reason, count in reasons.most_common():
        console.print(f"rejected {count}: {reason}", markup=False)
    if arguments.json is not None:
        source = corpus_source(arguments.corpus)
        write(arguments.json, None, source, rows=summary, rejected=reasons)


def summarise(rows: list[Row]) -> dict[str, float]:
    """One line of the table."""
    kept = [row for row in rows if row["kept"] == "True"]
    residuals = [float(row["residual_mm"]) for row in kept]
    slips = [(float(row["slip_mps"]), float(row["slip_source_mps"])) for row in kept
             if row["slip_mps"] and row["slip_source_mps"]]  # fmt: skip
    return {
        "pieces": len(rows),
        "converted": len(kept),
        "rejected": len(rows) - len(kept),
        "minutes": sum(float(row["seconds"]) for row in kept) / 60,
        "residual mm (median clip)": median(residuals) if residuals else float("nan"),
        "residual mm (worst clip)": max(residuals, default=float("nan")),
        "slip m/s": mean(ours for ours, _ in slips) if slips else float("nan"),
        "slip of the source m/s": mean(theirs for _, theirs in slips) if slips else float("nan"),
    }


if __name__ == "__main__":
    main()
