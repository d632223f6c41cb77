"""Means of `benchmarks.clouds` on the terminal."""

from rich.table import Table

from recon.api.bench.scores import WINDOWS, Row, Rows
from recon.api.bench.scores import by_subject as by_subject
from recon.api.bench.scores import rounded as rounded

Columns = dict[str, tuple[str, float]]
"""The heading of every metric, and what turns metres into centimetres or shares into per cent."""


def tables(title: str, columns: Columns, rows: dict[str, Rows]) -> tuple[Table, Table]:
    """One table of means, and one of the first column by subject."""
    first, (heading, factor) = next(iter(columns.items()))
    means = Table("method", *(name for name, _ in columns.values()), title=f"{title}, means")
    subjects = [name for name in next(iter(rows.values())) if name != WINDOWS]
    single = Table("method", *subjects, title=f"{title}: {heading}, by subject")
    for name, row in rows.items():
        means.add_row(name, *(_cell(row["mean"].get(k), f) for k, (_, f) in columns.items()))
        single.add_row(name, *(_cell(row.get(s, {}).get(first), factor) for s in subjects))
    return means, single


def _cell(value: Row | float | None, factor: float) -> str:
    return f"{value * factor:.2f}" if isinstance(value, float) else "–"
