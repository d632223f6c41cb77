"""`recon report`: a trial as a gait laboratory reads it."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from recon.cli.places import Arguments, Overwrite, Place, Quiet, writes
from recon.formats.outputs import Output


def _page_and_table(out: Path, _: Arguments) -> tuple[Output, ...]:
    # the room of pictures loads torch, which other verbs must not wait for
    from recon.gait.laboratory import outputs_of

    return outputs_of(out)


@writes(Place("out", _page_and_table))
def report(
    trial: Positional[Path],
    out: Path | None = None,
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None,
    up: Literal["x", "y", "z"] | None = None,
    mapping: Path | None = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Gait events, joint angles over the cycle, cadence, lengths and speed as one page.

    Of a recording (.c3d, .trc, .bvh, .amc, .mat) or a motion file. The page needs no network; the
    table beside it (.csv) has all its numbers. It needs matplotlib: pip install
    'motion-recon[report]'.

    Args:
        trial: recording, or motion file of `recon fit` or `recon convert`, whose report is read,
            too.
        out: page to write; default: the trial's name with .html, in this folder.
        unit: of a recording; default: found out.
        up: axis of a recording that points up; default: found out.
        mapping: JSON or TOML file that says which markers of a recording are which.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console

    if trial.suffix.lower() != ".npz" and mapping is None:
        from recon.cli.looks import refuse_unknown_recording

        refuse_unknown_recording(trial, unit, up)
    from recon.gait.report import report_file

    page, found = report_file(trial, out, unit=unit, up=up, mapping=mapping, overwrite=overwrite)
    figures = {
        f"{one.name} ({one.unit})": {"value": one.mean}
        for one in found.gait.figures
        if one.side == "both"
    }
    console.table(f"{trial}: {len(found.gait.cycles)} cycles of gait", figures)
    for warning in found.warnings:
        console.warn(warning)
    console.last(str(page))
