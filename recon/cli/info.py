"""`recon info`: what a file is, and how that was decided."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


def info(
    file: Positional[Path],
    json: Annotated[bool, arg(help="Print JSON on stdout.")] = False,
) -> None:
    """Say what a motion, observation, recording or body file holds.

    Args:
        file: any file that recon reads.
        json: print JSON on stdout.
    """
    from recon.cli import console
    from recon.info import describe

    facts = describe(file)
    if json:
        console.answer(facts)
    else:
        console.table(str(file), {key: {"value": value} for key, value in facts.items()})
