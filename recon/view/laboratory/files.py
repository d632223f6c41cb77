"""The files of a laboratory report."""

from pathlib import Path

from recon.formats.results.outputs import Output


def outputs_of(page: Path) -> tuple[Output, Output]:
    """The page and the table beside it.

    Raises:
        ValueError: when the page's name does not end in .html.
    """
    if page.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{page}: the report is a page; give a name that ends in .html")
    return Output(page), Output(page.with_suffix(".csv"))
