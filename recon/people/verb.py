"""`recon fit --person all`: everybody in files of 2D detections."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import OmitArgPrefixes, Positional, arg

from recon.cli.places import Overwrite, Place, Quiet, folder, writes
from recon.fitting.settings import FitSettings

_DEFAULTS = FitSettings(person="all")
_OF_ALL = ("weights", "method", "physics", "between", "fps", "device", "repair")
"""Settings that are the same for everybody."""


@writes(Place("out", folder))
def fit_all(
    observations: Positional[tuple[Path, ...]],
    out: Path,
    settings: OmitArgPrefixes[FitSettings] = _DEFAULTS,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Reconstruct everybody in files of 2D detections, all in one world.

    OUT is a folder with `person_0.npz` and so on, by the numbers that --person takes, and
    report.json.

    Args:
        observations: files and folders of 2D detections of one recording.
        out: folder to write.
        settings: how to fit.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console
    from recon.cli.looks import look_at
    from recon.cli.running import write_and_tell

    given: dict[str, Any] = {"observations": observations, "settings": settings}
    look_at(given)
    if settings.shape is not None:
        raise ValueError("--shape is of one person; leave it out with --person all")
    from recon.body.model import BodyModel
    from recon.people.everyone import people_in
    from recon.people.together import fit_people
    from recon.reading.inputs import input_checksums

    settings = replace(settings, person="all")
    inputs = input_checksums({"observations": observations, **vars(settings)})
    body = BodyModel.load(settings.body)
    people, notes = people_in(observations, settings, body)
    how = {name: getattr(settings, name) for name in _OF_ALL}
    arguments = settings.arguments()
    ground, how["checks"] = arguments["ground"], arguments["checks"]
    how["ground"] = "auto" if isinstance(ground, tuple) else ground  # the reader knows the plane
    with console.fitting({}) as watch:
        found = fit_people(
            people, settings.prior, notes=notes, body=body, noise=settings.noise_pixels,
            callback=watch, **how,
        )  # fmt: skip
    write_and_tell(found, out, inputs, vars(settings), {"overwrite": overwrite, "json": json})
