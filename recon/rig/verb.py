"""`recon register`: several depth cameras in one frame."""

from recon.cli.making import Verb, command
from recon.cli.places import Place, folder

register = command(
    "register",
    Verb("recon.rig.register:register", (Place("out", folder),), "folder for a file per camera."),
)
"""Bring depth cameras into one frame; see `recon.rig.register.register`."""
