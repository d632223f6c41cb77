"""recon: true human motion from noisy, partial observations.

Names are loaded on first use, so that importing the package (and `recon --help`) is immediate.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

from recon.core.plugins import lazy_names as _lazy

__version__ = "0.3.0"
__distribution__ = "motion-recon"

if TYPE_CHECKING:
    from observations.depth import PointCloud as PointCloud
    from observations.joints3d import Joints3D as Joints3D
    from observations.keypoints2d import Keypoints2D as Keypoints2D
    from observations.keypoints3d import Keypoints3D as Keypoints3D
    from observations.markers3d import Markers3D as Markers3D
    from recon.api.calibrate import calibrate as calibrate
    from recon.api.convert import convert as convert
    from recon.api.convert import to_body as to_body
    from recon.api.detect import detect as detect
    from recon.api.evaluate import evaluate as evaluate
    from recon.api.fit import complete as complete
    from recon.api.fit import fit as fit
    from recon.api.generate import predict as predict
    from recon.api.generate import sample as sample
    from recon.api.given import Shape as Shape
    from recon.api.interpolate import interpolate as interpolate
    from recon.api.label import label as label
    from recon.api.refine import refine as refine
    from recon.api.register import register as register
    from recon.api.result import Result as Result
    from recon.api.retarget import retarget as retarget
    from recon.api.simulate import simulate as simulate
    from recon.batch.clips import fit_clips as fit_clips
    from recon.benchmark.judged import bench as bench
    from recon.body.model import BodyModel as BodyModel
    from recon.core.camera import Camera as Camera
    from recon.core.errors import FormatError as FormatError
    from recon.core.errors import ObservationError as ObservationError
    from recon.core.errors import ReconError as ReconError
    from recon.core.errors import UnitsError as UnitsError
    from recon.core.errors import WeightsError as WeightsError
    from recon.core.motion import Motion as Motion
    from recon.formats.motions import load_motion as load_motion
    from recon.formats.motions import save_motion as save_motion
    from recon.gait.angles import joint_angles as joint_angles
    from recon.gait.report import report as report
    from recon.live.stream import Stream as Stream
    from recon.people.together import fit_people as fit_people
    from recon.reading.read import load_observation as load_observation
    from recon.reading.read import read as read

_HOMES = {
    "fit": "recon.api.fit",
    "read": "recon.reading.read",
    "load_observation": "recon.reading.read",
    "fit_clips": "recon.batch.clips",
    "fit_people": "recon.people.together",
    "Stream": "recon.live.stream",
    "Result": "recon.api.result",
    "Shape": "recon.api.given",
    "joint_angles": "recon.gait.angles",
    "bench": "recon.benchmark.judged",
    "complete": "recon.api.fit",
    "detect": "recon.api.detect",
    "refine": "recon.api.refine",
    "retarget": "recon.api.retarget",
    "sample": "recon.api.generate",
    "predict": "recon.api.generate",
    "interpolate": "recon.api.interpolate",
    "convert": "recon.api.convert",
    "label": "recon.api.label",
    "evaluate": "recon.api.evaluate",
    "simulate": "recon.api.simulate",
    "report": "recon.gait.report",
    "register": "recon.api.register",
    "calibrate": "recon.api.calibrate",
    "to_body": "recon.api.convert",
    "Joints3D": "observations.joints3d",
    "Markers3D": "observations.markers3d",
    "Keypoints2D": "observations.keypoints2d",
    "Keypoints3D": "observations.keypoints3d",
    "PointCloud": "observations.depth",
    "Camera": "recon.core.camera",
    "ReconError": "recon.core.errors",
    "FormatError": "recon.core.errors",
    "ObservationError": "recon.core.errors",
    "UnitsError": "recon.core.errors",
    "WeightsError": "recon.core.errors",
    "BodyModel": "recon.body.model",
    "load_motion": "recon.formats.motions",
    "save_motion": "recon.formats.motions",
    "Motion": "recon.core.motion",
}

_MOVED = {
    "Stage": "recon.method.stages",
    "Term": "recon.method.terms",
    "solve": "recon.method.reconstruction",
    "Reconstruction": "recon.method.reconstruction",
    "fit_long": "recon.fitting.long",
    "LongReconstruction": "recon.fitting.long",
    "LaboratoryReport": "recon.gait.laboratory",
    "LiveEstimate": "recon.live.tracking",
    "People": "recon.people.results",
    "MotionResult": "recon.api.results",
    "load_motion_of": "recon.body.motion_files",
    "load_people": "recon.people.together",
}
"""Names that were here until 0.2.0, with the modules where they are now."""


_with_known_names, __dir__ = _lazy(__name__, _HOMES)


def __getattr__(name: str) -> Any:
    if name in _MOVED:
        module = _MOVED[name]
        warn(f"recon.{name} is now {module}.{name}", DeprecationWarning, stacklevel=2)
        return getattr(import_module(module), name)
    return _with_known_names(name)
