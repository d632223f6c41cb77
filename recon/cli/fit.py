"""`recon fit`: observation files in, a motion out."""

from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from recon.cli.errors import Failed
from recon.settings import DEFAULTS, FitSettings


def fit(
    observations: Positional[tuple[Path, ...]],
    out: Path,
    settings: OmitArgPrefixes[FitSettings] = DEFAULTS,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
) -> None:
    """Reconstruct the motion behind observation files of one clip.

    Writes OUT (AMASS .npz with joints, contacts and ground) and OUT.json (what happened).

    Args:
        observations: 3D joints or markers (.npz); several files of one clip add up.
        out: motion file to write.
        settings: how to fit.
        json: print the report as JSON on stdout.
    """
    from recon.cli import console
    from recon.fit_files import fit_files

    with console.fitting({}) as watch:
        report = fit_files(observations, out, settings, watch)
    rows = {
        stage["name"]: {
            **stage["energies"],
            "iterations": stage["iterations"],
            "seconds": stage["seconds"],
            "ended because": stage["termination"],
        }
        for stage in report["stages"]
    }
    console.table(f"{out}: weighted energies", rows)
    if json:
        console.answer(report)
    if report["failed"]:
        reasons = "; ".join(s["termination"] for s in report["stages"])
        raise Failed(f"{out}: {reasons}")
