"""`recon fit --person all`: fits everybody in files of 2D keypoints."""

from recon.cli.making import Verb, command_function
from recon.cli.places import Place, folder_output
from recon.fitting.settings import FitSettings

fit_all = command_function(
    "fit-all",
    Verb(
        "recon.people.together:fit_files",
        (Place("out", folder_output),),
        "folder to write.",
        settings=FitSettings(person="all"),
    ),
)
"""Reconstruct everybody in files; see `recon.people.together.fit_files`."""
