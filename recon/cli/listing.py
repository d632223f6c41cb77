"""True human motion from noisy, partial observations.

`recon VERB --help` tells a verb's options, with examples; `recon --version` what is installed.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from recon.cli.making import Verb, command_function
from recon.cli.places import Arguments, Place, folder_or_npz_output, folder_output, report_output
from recon.core.plugins import VERBS, registered_places
from recon.fitting.settings import FitSettings
from recon.formats.outputs import Output, OutputKind


def _file_or_folder_output(out: Path, given: Arguments) -> tuple[Output, ...]:
    """Return the output of `recon simulate`: a file, or a folder for scans or several cameras."""
    several = given["kind"] == "scans" or given["views"] > 1 or out.is_dir()
    return (
        Output(out, OutputKind.FOLDER if several and out.suffix != ".npz" else OutputKind.FILE),
    )


_SEVERAL = "motion file (.npz) for one motion, or a folder for several."
CORE = {
    "demo": Verb("recon.api.demo:demo", (Place("out", folder_output),)),
    "detect": Verb(
        "recon.api.detect:detect", (Place("out"),), "file of 2D keypoints to write (.npz)."
    ),
    "fit": Verb("recon.api.fit:fit", settings=FitSettings()),
    "complete": Verb("recon.api.fit:complete", settings=FitSettings(prior="recording")),
    "refine": Verb("recon.api.refine:refine", settings=FitSettings(ground="unknown")),
    "convert": Verb("recon.api.convert:convert", out_follows=True),
    "label": Verb(
        "recon.api.label:label",
        (Place("out"),),
        "file of named markers to write (.c3d, .trc or .csv).",
    ),
    "sample": Verb("recon.api.generate:sample", (Place("out", folder_or_npz_output),), _SEVERAL),
    "predict": Verb("recon.api.generate:predict", (Place("out", folder_or_npz_output),), _SEVERAL),
    "interpolate": Verb("recon.api.interpolate:interpolate"),
    "retarget": Verb("recon.api.retarget:retarget"),
    "simulate": Verb(
        "recon.api.simulate:simulate",
        (Place("out", _file_or_folder_output),),
        "observation file to write; a folder for several cameras. Of scans, .npz is one file and "
        "all else a folder of .ply files.",
        out_follows=True,
    ),
    "register": Verb(
        "recon.api.register:register",
        (Place("out", folder_output),),
        "folder for a file per camera.",
    ),
    "calibrate": Verb(
        "recon.api.calibrate:calibrate",
        (Place("out"),),
        "calibration to write (.toml), which `--camera` reads; OUT.json tells what was found.",
    ),
    "evaluate": Verb(
        "recon.api.evaluate:evaluate",
        (Place("json", report_output),),
        "File for the metrics.",
    ),
    "view": Verb(
        "recon.view.files:view",
        (
            Place("html"),
            Place("png"),
            Place("mp4"),
            Place("rrd"),
        ),
    ),
    "info": Verb("recon.view.info:info", ()),
}
"""Verbs of the core, in the order of `recon --help`; those of other rooms are registered."""
WHOLE = {"convert": ("--all",), "fit": ("--person", "all")}
"""Options that make a verb one of many clips or people: `convert --all` runs the verb
`convert-all`, which another room registers."""


def verb_names() -> tuple[str, ...]:
    """Return all verbs of the command line: built-in ones, then those of other packages."""
    return (
        *CORE,
        *sorted(name for name, place in registered_places(VERBS).items() if _is_installed(place)),
    )


def _is_installed(place: str) -> bool:
    try:
        return find_spec(place.partition(":")[0]) is not None
    except ModuleNotFoundError:
        return False


@cache
def function_of_verb(name: str) -> Callable[..., None]:
    """Return the function that runs a verb of the command line."""
    if name in CORE:
        return command_function(name, CORE[name])
    module, _, function = registered_places(VERBS)[name].partition(":")
    return getattr(import_module(module), function)
