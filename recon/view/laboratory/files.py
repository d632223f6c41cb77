"""The files of a laboratory report."""

from pathlib import Path

from recon.formats.results.outputs import Output


def outputs_of(page: Path) -> tuple[Output, Output]:
    """The page and the table beside it, whose name ends in .csv instead."""
    return Output(page), Output(page.with_suffix(".csv"))
