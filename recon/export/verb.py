"""`recon export`: write a motion in formats of other programs."""

from recon.cli.making import Verb, command_function
from recon.cli.places import Place, folder_output

export = command_function(
    "export",
    Verb(
        "recon.export.motion:export_file",
        (
            Place("glb"), Place("usd"), Place("bvh"), Place("trc"), Place("mot"),
            Place("forces"), Place("moments"), Place("angles"), Place("joints"), Place("robot"),
            Place("smpl"), Place("ply", folder_output), Place("html"),
        ),
    ),
)  # fmt: skip
"""Write a motion for other programs; see `recon.export.motion.export_file`."""
