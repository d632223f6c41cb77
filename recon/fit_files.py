"""Observation files in, a motion file and a report out: what `fit` and `batch` do to one clip."""

import hashlib
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from observations.files import load
from observations.noise import estimate_noise
from priors.pose import PosePrior, PoseWeights
from recon.body import BodyModel
from recon.contacts import contact_labels, rest_heights
from recon.formats.amass import MotionFile, save_motion
from recon.formats.files import replacing
from recon.ingest.soles import Soles, Stance
from recon.motion import Motion
from recon.reconstruction import Reconstruction, fit
from recon.settings import FitSettings
from recon.stages import Watch


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
    prior = PosePrior.load(weights=PoseWeights.for_noise(noises[0])).to(device=settings.device)
    weights = [(noises[0] / noise) ** 2 for noise in noises]
    result = fit(observations, prior, body, weights=weights, watch=watch)
    motion = result.clip(0).detach().to(device="cpu")
    if settings.fps is not None:
        motion = motion.resample(settings.fps)
    report = describe(result, paths, settings) | {"noise": noises}
    known = all(observation.ground_known for observation in observations)
    ground = 0.0 if known else Stance.of(motion, here, Soles.of(here)).height()
    write_result(out, motion, here, report | {"ground_known": known}, ground)
    return report


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
    stages = [
        {
            "name": report.stage.name,
            "seconds": round(report.seconds, 4),
            "iterations": int(report.solution.iterations[0]),
            "evaluations": int(report.solution.evaluations[0]),
            "termination": report.solution.termination[0].value,
            "energies": {
                term.name: float(value)
                for term, value in zip(
                    report.stage.terms, report.solution.trace[0, -1], strict=True
                )
            },
        }
        for report in result.reports
    ]
    return {
        "failed": result.failed[0],
        "stages": stages,
        "settings": asdict(settings),
        "inputs": {str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths},
        "versions": {
            "recon": version("motion-recon"),
            "torch": torch.__version__,
            "python": platform.python_version(),
        },
    }
