"""`recon info`: what a file is, and how that was decided."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


def info(
    file: Positional[Path],
    json: Annotated[bool, arg(help="Print JSON on stdout.")] = False,
) -> None:
    """Say what a file or folder holds, and how that was told.

    Motions, observations, recordings, bodies, 2D keypoints, calibrations, scans, depth images.

    Args:
        file: any file or folder that recon reads.
        json: print JSON on stdout.
    """
    from recon.cli import console
    from recon.cli.inputs import check_inputs

    check_inputs({"file": file})
    from recon.jobs.info.files import describe

    facts = describe(file)
    if json:
        console.answer(facts)
    else:
        console.facts(str(file), facts)
