"""Prints the output of commands: progress and tables on stderr, answers on stdout."""

import json
import logging
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from recon.core.visible import visible

if TYPE_CHECKING:
    from rich.progress import Progress

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)
_DIM, _YELLOW, _PLAIN = "\x1b[2m", "\x1b[33m", "\x1b[0m"


@contextmanager
def quiet_if(is_quiet: bool) -> Iterator[None]:
    """Context that, with `--quiet`, suppresses output except errors, answers and last lines."""
    before, log = _quiet.set(is_quiet), logging.getLogger()
    level = log.level
    log.setLevel(logging.ERROR if is_quiet else level)
    try:
        yield
    finally:
        log.setLevel(level)
        _quiet.reset(before)


def print_progress(message: str) -> None:
    """Print a line about progress to stderr."""
    if not _quiet.get():
        _print_line(message)


def print_note(message: str) -> None:
    """Print a remark, such as an assumption that explains the result."""
    if not _quiet.get():
        _print_line(message, _DIM)


def print_warning(message: str) -> None:
    """Print a warning: a line that should be read before the result is used."""
    if not _quiet.get():
        _print_line(f"warning: {message}", _YELLOW)


def print_error(message: str) -> None:
    """Print an error after which the command goes on with the rest of its work."""
    _print_line(message)


def print_last_line(message: str) -> None:
    """Print the last line of a verb, which says where its result is."""
    _print_line(message)


def print_findings(report: Mapping[str, Any]) -> None:
    """Print the findings of a report: remarks, repairs and warnings, in this order."""
    for finding in report.get("diagnosis", []):
        print_note(finding["message"])
    for finding in report.get("repairs", []):
        print_progress(f"repaired: {finding['message']}")
    for finding in report.get("warnings", []):
        print_warning(finding if isinstance(finding, str) else finding["message"])


def print_json(value: Mapping[str, Any]) -> None:
    """Print a command's result for programs, as one JSON object on stdout."""
    sys.stdout.write(json.dumps(value, indent=1, default=str) + "\n")


def print_facts(title: str, values: Mapping[str, Any]) -> None:
    """Print a command's result for people on stdout, a name and a value per row."""
    _print_rows(title, {name: {"value": value} for name, value in values.items()}, stderr=False)


def print_table(title: str, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a table on stderr: rows by name, a column per key; without rows, the title alone."""
    if not _quiet.get():
        _print_rows(title, rows, stderr=True)


def _print_rows(title: str, rows: Mapping[str, Mapping[str, Any]], *, stderr: bool) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text  # plain text, in which rich interprets no markup

    shown = Table(title=Text(visible(title)), title_justify="left")
    columns = list(dict.fromkeys(key for row in rows.values() for key in row))
    for column in ("", *columns):
        justify = "right" if column else "left"
        shown.add_column(Text(visible(column)), justify=justify, overflow="fold")
    for name, row in rows.items():
        cells = (name, *(_cell_text(row.get(column)) for column in columns))
        shown.add_row(*(Text(visible(cell)) for cell in cells))
    Console(stderr=stderr).print(shown if rows else shown.title)


def _cell_text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        sentences = any(" " in str(one) for one in value)
        return ("\n" if sentences else ", ").join(map(str, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@contextmanager
def stage_progress_bars(limits: Mapping[str, int]) -> Iterator[Any]:
    """Context with a progress bar per stage; yields the callback for `recon.fit`.

    The bars appear with the first call, so that nothing is loaded for a fit that is refused.
    """
    with ExitStack() as until_the_end:
        bars: list[Progress] = []
        tasks: dict[str, Any] = {}

        def watch(stage: str, progress: Any) -> None:
            if _quiet.get():
                return
            if len(bars) == 0:
                bars.append(until_the_end.enter_context(_stage_bars()))
            if stage not in tasks:
                tasks[stage] = bars[0].add_task(stage, total=limits.get(stage))
            bars[0].update(tasks[stage], completed=int(progress.iterations.max()))

        yield watch


def _stage_bars() -> "Progress":
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

    steps = TextColumn("{task.completed} steps")
    name = TextColumn("{task.description}", markup=False)
    return progress_bars(name, BarColumn(), steps, TimeElapsedColumn())


def progress_bars(*columns: Any) -> "Progress":
    """Progress bars on stderr that vanish at the end: name, bar, share, time left."""
    from rich.console import Console
    from rich.progress import Progress

    return Progress(*columns, console=Console(stderr=True), transient=True, disable=_quiet.get())


def _print_line(message: str, colour: str = "") -> None:
    coloured = colour and sys.stderr.isatty() and not os.environ.get("NO_COLOR")
    shown = visible(message)
    sys.stderr.write(f"{colour}{shown}{_PLAIN}\n" if coloured else f"{shown}\n")
