"""recon: true human motion from noisy, partial observations.

Names are loaded on first use, so that importing the package (and `recon --help`) is immediate.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__distribution__ = "motion-recon"

if TYPE_CHECKING:
    from recon.body import BodyModel as BodyModel
    from recon.evaluation import evaluate as evaluate
    from recon.formats.amass import load_motion as load_motion
    from recon.formats.amass import save_motion as save_motion
    from recon.long import LongReconstruction as LongReconstruction
    from recon.long import fit_long as fit_long
    from recon.motion import Motion as Motion
    from recon.motion_files import load_motion_of as load_motion_of
    from recon.reconstruction import Reconstruction as Reconstruction
    from recon.reconstruction import fit as fit
    from recon.stages import Stage as Stage
    from recon.terms import Term as Term

_HOMES = {
    "BodyModel": "recon.body",
    "evaluate": "recon.evaluation",
    "load_motion": "recon.formats.amass",
    "save_motion": "recon.formats.amass",
    "LongReconstruction": "recon.long",
    "fit_long": "recon.long",
    "Motion": "recon.motion",
    "load_motion_of": "recon.motion_files",
    "Reconstruction": "recon.reconstruction",
    "fit": "recon.reconstruction",
    "Stage": "recon.stages",
    "Term": "recon.terms",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'recon' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
