"""`recon complete`: a recording of which little was seen: sparse scans, landmarks, few frames."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from recon.cli.places import Overwrite, Place, Quiet, writes
from recon.cli.verbs.fit import fit_and_say
from recon.fitting.settings import DEFAULTS, FitSettings

_DEFAULTS = replace(DEFAULTS, prior="recording")


@writes(Place("out"))
def complete(
    observations: Positional[tuple[Path, ...]],
    out: Path,
    settings: OmitArgPrefixes[FitSettings] = _DEFAULTS,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Complete a recording of which little was seen, of any length and any motion.

    Few points of every frame, a few landmarks, few frames at odd times, or all of these: a folder
    of scans (.ply, .pcd) with times.csv or --frame-rate, or observation files (.npz) of points,
    3D markers or joints. Several of one clip add up. HuMoR explains the whole, with one shape;
    where few moments were seen, cycles of gait that explain the data join them. The report says
    what was used when.

    With --prior anchor, one cycle of gait (0.3 to 3 s, cut out with --between) is completed as
    one code, and what is no cycle as well, with a warning.

    Writes OUT (AMASS .npz with joints, contacts and ground) and OUT.json (what happened).

    Args:
        observations: files and folders of one clip.
        out: motion file to write.
        settings: how to fit.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    if settings.prior not in ("recording", "anchor"):
        raise ValueError(
            f"`complete` is `fit` with the priors recording and anchor; for {settings.prior}, run "
            f"`recon fit --prior {settings.prior}`"
        )
    fit_and_say(observations, out, settings, json=json, overwrite=overwrite)
