"""Observation files in, a motion file and a report out: what `fit` and `batch` do to one clip."""

import hashlib
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import torch

from observations.files import load
from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from observations.noise import estimate_noise
from recon.body import BodyModel
from recon.contacts import contact_labels, rest_heights
from recon.formats.amass import MotionFile, save_motion
from recon.formats.files import replacing
from recon.ingest.soles import Soles, Stance
from recon.long import LongReconstruction, fit_long
from recon.methods import method_of
from recon.motion import Motion
from recon.reconstruction import Reconstruction, fit
from recon.settings import FitSettings
from recon.solver import Termination
from recon.stages import StageReport, Watch

LONG = 10.0
"""Seconds; longer recordings are fitted by windows."""

POSE = FitSettings(prior="pose")

UP = (0.0, 0.0, 1.0)

Points = TypeVar("Points", bound=Joints3D | Markers3D)


def fit_files(
    paths: Sequence[Path], out: Path, settings: FitSettings, watch: Watch | None = None
) -> dict[str, Any]:
    """Fit one clip's observation files and write OUT and OUT.json.

    Returns the report; its `failed` says whether the fit met nan or inf, in which case the last
    finite estimate was written.

    Raises:
        FileNotFoundError, ValueError: for bad input; nothing is written then.
    """
    if len(paths) == 0:
        raise ValueError("nothing to fit: expected at least one observation file, got none")
    torch.manual_seed(settings.seed)
    body = BodyModel.load(settings.body).to(device=settings.device)
    ask = {"unit": settings.unit, "up": settings.up, "robust": settings.robust}
    here = body.to(device="cpu")
    observations = [load(path, here, **ask).to(device=settings.device) for path in paths]
    noises = [settings.noise or estimate_noise(o.positions, o.visible) for o in observations]
    weights = [(noises[0] / noise) ** 2 for noise in noises]
    long = observations[0].positions.shape[-3] > LONG * observations[0].fps
    reconstruct = partial(fit_long if long else fit, body=body, weights=weights, watch=watch)

    known, ground = all(observation.ground_known for observation in observations), 0.0
    if not known:  # what a prior says of feet, it says of heights above the ground
        free = reconstruct(observations, prior=method_of(POSE, noises[0], body))
        ground = Stance.of(free.clip(0).detach().to(device="cpu"), here, Soles.of(here)).height()
        observations = [_raised(observation, -ground) for observation in observations]
    result = reconstruct(observations, prior=method_of(settings, noises[0], body))
    motion = result.clip(0).detach().to(device="cpu")
    motion = motion.replace(
        translation=motion.translation + ground * motion.translation.new_tensor(UP)
    )
    motion = motion.resample(observations[0].fps if settings.fps is None else settings.fps)
    report = describe(result, paths, settings) | {"noise": noises, "ground_known": known}
    write_result(out, motion, here, report, ground)
    return report


def _raised(observation: Points, height: float) -> Points:
    positions = observation.positions + height * observation.positions.new_tensor(UP)
    return observation.replace(positions=positions.where(observation.visible[..., None], 0.0))


def write_result(
    out: Path, motion: Motion, body: BodyModel, report: dict[str, Any], ground: float = 0.0
) -> None:
    """The motion file with joints, contacts and ground (its height), and its report beside it."""
    out.parent.mkdir(parents=True, exist_ok=True)
    joints = body.pose(motion).joints
    above = joints - joints.new_tensor([0.0, 0.0, ground])
    labels = contact_labels(above, rest_heights(body, motion.shape), motion.fps)
    save_motion(
        out,
        MotionFile(
            motion,
            body=body.name,
            checksum=body.checksum,
            joints=joints,
            contacts=labels.to(joints),
            ground=torch.tensor([0.0, 0.0, 1.0, ground]),
        ),
    )
    with replacing(out.with_name(out.name + ".json")) as beside:
        beside.write_text(json.dumps(report, indent=1, default=str))


def describe(
    result: Reconstruction, paths: Sequence[Path], settings: FitSettings
) -> dict[str, Any]:
    """What happened, stage by stage, and to what: the contents of OUT.json."""
    windows = result.windows if isinstance(result, LongReconstruction) else ()
    failed = result.failed_windows if isinstance(result, LongReconstruction) else ()
    return {
        "failed": result.failed[0],
        "stages": [_stage(report) for report in result.reports],
        "windows": [
            {"start": start, "stop": stop, "failed": row in failed}
            for row, (start, stop) in enumerate(windows)
        ],
        "settings": asdict(settings),
        "inputs": {str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths},
        "versions": {
            "recon": version("motion-recon"),
            "torch": torch.__version__,
            "python": platform.python_version(),
        },
    }


def _stage(report: StageReport) -> dict[str, Any]:
    """One line; of several windows the most steps, the sums of energies, all reasons to end."""
    solution = report.solution
    energies = solution.trace[:, -1].sum(0).tolist()
    reasons = [reason for reason in Termination if reason in solution.termination]
    return {
        "name": report.stage.name,
        "seconds": round(report.seconds, 4),
        "iterations": int(solution.iterations.max()),
        "evaluations": int(solution.evaluations.max()),
        "termination": "; ".join(reason.value for reason in reasons),
        "energies": {
            term.name: value for term, value in zip(report.stage.terms, energies, strict=True)
        },
    }
