"""`recon fit --person all`: everybody in files of 2D detections."""

from recon.cli.making import Verb, command
from recon.cli.places import Place, folder
from recon.fitting.settings import FitSettings

fit_all = command(
    "fit-all",
    Verb(
        "recon.people.together:fit_files",
        (Place("out", folder),),
        "folder to write.",
        settings=FitSettings(person="all"),
    ),
)
"""Reconstruct everybody in files; see `recon.people.together.fit_files`."""
