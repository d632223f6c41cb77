"""`recon interpolate`: what lies between two motions."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from recon.cli.places import Overwrite, Place, Quiet, writes


@writes(Place("out"))
def interpolate(
    a: Positional[Path],
    b: Positional[Path],
    out: Path,
    at: float = 0.5,
    weights: str = "open",
    fps: float | None = None,
    body: Path | None = None,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Make the cycle of gait that lies between those of two motions.

    Of each the best cycle is taken, both from the same foot on; the anchor-frame prior mixes
    their codes and bodies. It begins between where they begin, facing between them.

    Args:
        a: motion file (.npz) that walks or runs.
        b: another.
        out: motion file (.npz) to write.
        at: share of the second, from 0 to 1.
        weights: `open`, `nc` or a file.
        fps: of the result; default: the first file's.
        body: the SMPL-family file of both motions' body; default: the bundled body.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console
    from recon.jobs.interpolate import InterpolationSettings, interpolate_files

    settings = InterpolationSettings(at, weights, body, fps)
    report = interpolate_files(a, b, out, settings, overwrite=overwrite)
    console.table(f"{out}, {at:g} of the way", {"seconds": report["durations"]})
    console.last(str(out))
    if json:
        console.answer(report)
