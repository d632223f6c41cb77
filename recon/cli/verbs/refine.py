"""`recon refine`: a motion that another program estimated, as a person would have moved."""

from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from recon.cli.places import Overwrite, Place, Quiet, writes
from recon.cli.verbs.fit import tell
from recon.fitting.settings import RefineSettings

_DEFAULTS = RefineSettings()


@writes(Place("out"))
def refine(
    motion: Positional[Path],
    out: Path,
    settings: OmitArgPrefixes[RefineSettings] = _DEFAULTS,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Refine a motion that a network told from video: feet that stand, no jitter, impacts kept.

    MOTION is a file of per-frame SMPL parameters: GVHMR (.pt), WHAM (.pkl), SLAHMR, SMPL-X or
    AMASS (.npz), or a motion file. Nothing in it is run.

    Writes OUT (AMASS .npz with joints, contacts and ground) and OUT.json (what happened).

    Args:
        motion: file of the estimate.
        out: motion file to write.
        settings: how to refine.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console
    from recon.cli.own import check_plugs

    check_plugs(settings.prior, None)
    from recon.jobs.refine import refine_files

    with console.fitting({}) as watch:
        report = refine_files(motion, out, settings, watch, overwrite=overwrite)
    tell(report, out, json=json)
