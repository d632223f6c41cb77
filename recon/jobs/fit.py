"""Observation files in, a motion file and a report out: what `fit` and `batch` do to one clip."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.diagnosis.examination import fit_examined
from recon.diagnosis.fits.domain import cycle_report
from recon.diagnosis.motions.treadmill import in_room, path_of_belt
from recon.fitting.clip_files import load_clip, window
from recon.fitting.clip_inputs import input_checksums
from recon.fitting.long import LongReconstruction
from recon.fitting.settings import FitSettings
from recon.formats.motions import MotionFile, save_motion
from recon.jobs.results.inputs import paths_in
from recon.jobs.results.outputs import Output, check_outputs
from recon.jobs.results.reports import versions
from recon.jobs.results.writing import writing_file
from recon.method.reconstruction import Reconstruction
from recon.method.stages import StageReport, Watch
from recon.solver.lbfgs import Termination

UP = (0.0, 0.0, 1.0)


def fit_files(
    paths: Sequence[Path],
    out: Path,
    settings: FitSettings,
    watch: Watch | None = None,
    *,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Fit one clip's observation files and write OUT and OUT.json.

    The prior `anchor` completes them to one cycle of gait; the report then has `cycle`.
    Returns the report; its `failed` says whether the fit met nan or inf, in which case the last
    finite estimate was written.

    Raises:
        FileNotFoundError, ValueError: for bad input; nothing is written then.
        FileExistsError: when OUT or OUT.json is there and recon did not write it, unless
            `overwrite`.
    """
    check_outputs([Output(out)], paths_in((*paths, settings)), overwrite=overwrite)
    torch.manual_seed(settings.seed)
    body = BodyModel.load(settings.body)
    # before anything is read: what changes from now on must not pass for what was fitted
    inputs = input_checksums(paths, settings)
    clip = load_clip(paths, settings, body)
    if settings.between is not None:
        clip = window(clip, *settings.between)
    seen = [observation.to(device=settings.device) for observation in clip.observations]
    completes = settings.prior == "anchor"
    examined = fit_examined(seen, clip.names, settings, body.to(device=settings.device), watch)
    found = examined.fit
    motion = found.result.clip(0).detach().to(device="cpu")
    # the clock of few scans is too slow to show a motion
    rate = max(seen[0].fps, motion.fps) if completes else seen[0].fps
    motion = motion.resample(rate if settings.fps is None else settings.fps)
    T, ground = found.T_world_recording[0].double(), 0.0
    if clip.T_recording_camera is None and not found.ground_known:
        # 3D recordings with z up keep their frame; only the ground is lower or higher there
        ground = -float(T[2, 3])
        motion = motion.replace(
            translation=motion.translation + ground * motion.translation.new_tensor(UP)
        )
    T_world_camera = None
    if clip.T_recording_camera is not None:
        T_world_camera = (T @ torch.from_numpy(clip.T_recording_camera)).float()
    report = describe(found.result, inputs, settings) | {
        "noise": [asdict(noise) for noise in found.noises],
        "ground_known": found.ground_known,
        "read": clip.notes,
        "residuals": [summary.report() for summary in examined.residuals],
    }
    warnings = examined.warnings
    if completes:
        cycle = cycle_report(found, examined.residuals)
        report |= {"cycle": cycle.numbers}
        warnings = (*warnings, *cycle.warnings)
    report |= {
        name: [finding.report() for finding in findings]
        for name, findings in (
            ("diagnosis", examined.diagnosis),
            ("repairs", examined.repairs),
            ("warnings", warnings),
        )
    }
    belt = None
    if examined.belt is not None:
        belt = path_of_belt(motion, examined.belt)
        motion = in_room(motion, examined.belt)
    observed = torch.from_numpy(examined.observed_at(motion))
    write_result(
        out, motion, body, report, ground, T_world_camera, observed, belt, overwrite=overwrite
    )
    return report


def write_result(
    out: Path,
    motion: Motion,
    body: BodyModel,
    report: dict[str, Any],
    ground: float = 0.0,
    T_world_camera: Float[Tensor, "4 4"] | None = None,
    observed: Bool[Tensor, "time 22"] | None = None,
    belt: Float[Tensor, "time 3"] | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write the motion file with joints, contacts and ground (its height), and its report.

    Where a camera's pose was found, the file has it and the root in the camera's frame besides.
    On a treadmill, contacts are told against the belt, by how far it has come.
    The two are put in place together, the report first.

    Raises:
        FileExistsError: when either is there and recon did not write it, unless `overwrite`.
    """
    joints = body.pose(motion).joints
    above = joints - joints.new_tensor([0.0, 0.0, ground])
    if belt is not None:
        above = above - belt[:, None]
    labels = contact_labels(above, rest_heights(body, motion.shape), motion.fps)
    file = MotionFile(
        motion,
        body=body.name,
        checksum=body.checksum,
        joints=joints,
        contacts=labels.to(joints),
        ground=torch.tensor([0.0, 0.0, 1.0, ground]),
        observed=observed,
        T_world_camera=None if T_world_camera is None else T_world_camera[None],
        in_camera=None if T_world_camera is None else in_camera(motion, T_world_camera, body),
    )
    with writing_file(out, report, overwrite=overwrite) as staged:
        save_motion(staged, file)


def in_camera(
    motion: Motion, T_world_camera: Float[Tensor, "4 4"], body: BodyModel
) -> Float[Tensor, "time 6"]:
    """SMPL translation and root rotation vector of the same motion in the camera's frame."""
    pelvis = body.rest_joints(motion.shape)[..., 0, :]
    seen = motion.carried(torch.linalg.inv(T_world_camera), pelvis)
    return torch.cat((seen.translation, so3.log(seen.rotations[:, 0].double()).float()), -1)


def describe(
    result: Reconstruction, inputs: Mapping[str, str], settings: FitSettings
) -> dict[str, Any]:
    """What happened, stage by stage, and to what: the contents of OUT.json.

    Args:
        result: of the fit.
        inputs: SHA-256 of everything that was read, by path (`recon.fitting.clip_inputs`).
        settings: of the fit.
    """
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
        "inputs": dict(inputs),
        "versions": versions(),
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
