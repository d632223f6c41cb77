"""A result file against a truth file: what `recon evaluate` does."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from observations.files.points import positions_of
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.motion import Motion
from recon.formats.motions import MotionFile
from recon.formats.observations import ObservationFile, PositionsFile, load_observation
from recon.formats.results.reports import checksums, versions
from recon.formats.results.writing import write_report
from recon.method.protocols import Estimate
from recon.metrics.evaluation import ObservedPoints, evaluate, ground_errors, nearest_labels

_ON_ITS_GROUND = ("penetration", "sole_penetration", "contact", "slip_speed")
"""How metrics that judge a result by the ground it stands on begin."""


def evaluate_files(
    result: Path,
    truth: Path,
    observation: Path | None,
    out: Path | None,
    body: Path | None = None,
    *,
    overwrite: bool = False,
) -> dict[str, float | None]:
    """All metrics of `result`, written to `out` if given, with checksums and versions.

    Where the observation's camera did not know its pose and the simulation kept it
    (`truth_T_world_camera`), errors are taken in the true world, into which the camera carries
    the result: x_true = T_true_camera inv(T_result_camera) x. Contacts, slip and depth below the
    ground stay those of the ground that was found. How far that ground is off in the camera's
    frame are `ground_normal` (radians) and `ground_height` (metres); else they are None.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when a file is damaged, the bodies differ, or the truth does not cover the
            result's times.
        FileExistsError: when `out` is there and recon did not write it, unless `overwrite`.
    """
    model = BodyModel.load(body).to(dtype=torch.float64)
    ours, theirs = load_motion_of(result, model), load_motion_of(truth, model)
    seen = None if observation is None else load_observation(observation)
    labels = _there(theirs, "contacts", ours.motion)
    metrics = evaluate(
        ours.motion,
        theirs.motion,
        model,
        contacts=ours.contacts,
        truth_contacts=labels,
        truth_visible=_visible(seen, theirs, ours.motion),
        observed=_observed(ours, theirs, seen, observation, model),
    )
    metrics |= {"ground_normal": None, "ground_height": None}
    if (poses := _camera_poses(ours, seen, result)) is not None:
        found, true = poses
        pelvis = model.rest_joints(ours.motion.shape)[0]
        carried = ours.motion.carried(true @ torch.linalg.inv(found), pelvis)
        there = evaluate(
            carried,
            theirs.motion,
            model,
            truth_contacts=labels,
            truth_visible=_visible(seen, theirs, ours.motion),
        )
        own = {key: value for key, value in metrics.items() if key.startswith(_ON_ITS_GROUND)}
        metrics |= there | own | ground_errors(found, true)
    if out is not None:
        read = [path for path in (result, truth, observation) if path is not None]
        about = {"inputs": checksums(read), "versions": versions()}
        write_report(out, metrics | about, overwrite=overwrite)
    return metrics


def _there(file: MotionFile, name: str, motion: Motion) -> torch.Tensor | None:
    labels = getattr(file, name)
    return None if labels is None else nearest_labels(labels, file.motion.times, motion.times)


def _camera_poses(
    ours: MotionFile, seen: ObservationFile | None, result: Path
) -> tuple[Float[Tensor, "4 4"], Float[Tensor, "4 4"]] | None:
    """T_world_camera as it was found and as it was; None where either is not known.

    Raises:
        ValueError: when several poses were found, though the camera stood still.
    """
    if seen is None or isinstance(seen, PositionsFile) or seen.truth_T_world_camera is None:
        return None
    if ours.T_world_camera is None:
        return None
    if len(ours.T_world_camera) != 1:
        raise ValueError(
            f"{result}: has {len(ours.T_world_camera)} poses in T_world_camera, but the "
            "observation is of a camera that stood still; expected one"
        )
    true = torch.from_numpy(seen.truth_T_world_camera)
    return ours.T_world_camera[0].to(true), true


def _visible(
    seen: ObservationFile | None, truth: MotionFile, motion: Motion
) -> torch.Tensor | None:
    """Joints the sensor could see, from the simulated observation or the truth file."""
    if seen is not None and seen.truth_visible is not None:
        labels = torch.from_numpy(seen.truth_visible)
        times = seen.start_time + torch.arange(len(labels), dtype=torch.float64) / seen.fps
        return nearest_labels(labels, times, motion.times)
    return _there(truth, "truth_visible", motion)


def _observed(
    ours: MotionFile,
    theirs: MotionFile,
    file: ObservationFile | None,
    path: Path | None,
    body: BodyModel,
) -> ObservedPoints | None:
    """The observation's own points on the result and on the truth, at the result's frames."""
    if path is None or not isinstance(file, PositionsFile):
        return None
    adapter = positions_of(file, path, body.to(dtype=torch.float32))
    truth = theirs.motion.at(ours.motion.times, ours.motion.fps)
    predicted, actual = (
        adapter.predict(Estimate.of_clip(motion, body))[0] for motion in (ours.motion, truth)
    )
    seen = torch.from_numpy(file.visible)
    times = file.start_time + torch.arange(len(seen), dtype=torch.float64) / file.fps
    return ObservedPoints(predicted, actual, nearest_labels(seen, times, ours.motion.times))
