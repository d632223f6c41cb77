"""What a person sees: progress and tables on stderr, one JSON object on stdout."""

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

stderr = Console(stderr=True)


def say(message: str) -> None:
    """A line for the person at the terminal."""
    stderr.print(message, highlight=False, markup=False, soft_wrap=True)


def note(message: str) -> None:
    """A line about what was assumed, which matters when the result surprises."""
    stderr.print(message, style="dim", highlight=False, markup=False, soft_wrap=True)


def warn(message: str) -> None:
    """A line that should be read before the result is used."""
    stderr.print(f"warning: {message}", style="yellow", highlight=False, markup=False,
                 soft_wrap=True)  # fmt: skip


def findings(report: Mapping[str, Any]) -> None:
    """What a report found: remarks, repairs that were made, and warnings, in this order."""
    for finding in report.get("diagnosis", []):
        note(finding["message"])
    for finding in report.get("repairs", []):
        say(f"repaired: {finding['message']}")
    for finding in report.get("warnings", []):
        warn(finding["message"])


def answer(value: Mapping[str, Any]) -> None:
    """The result of a verb for a program: one JSON object on stdout."""
    sys.stdout.write(json.dumps(value, indent=1, default=str) + "\n")


def table(title: str, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """Rows by name, one column per key of the first."""
    shown = Table(title=title, title_justify="left")
    columns = list(dict.fromkeys(key for row in rows.values() for key in row))
    for column in ("", *columns):
        shown.add_column(column, justify="right" if column else "left")
    for name, row in rows.items():
        shown.add_row(name, *(_cell(row.get(column)) for column in columns))
    stderr.print(shown)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        sentences = any(" " in str(one) for one in value)
        return ("\n" if sentences else ", ").join(map(str, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@contextmanager
def fitting(limits: Mapping[str, int]) -> Iterator[Any]:
    """A bar per stage; yields the `watch` that `recon.fit` calls."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed} steps"))
    with Progress(*columns, TimeElapsedColumn(), console=stderr, transient=True) as bars:
        tasks: dict[str, Any] = {}

        def watch(stage: str, progress: Any) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=limits.get(stage))
            bars.update(tasks[stage], completed=int(progress.iterations.max()))

        yield watch
