"""`recon.evaluate`: metrics of a reconstructed motion against the true motion."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.checks import refuse_other_units
from recon.api.given import BodyLike, MotionLike, body_given, motion_given
from recon.api.results import Tables, closing_fields, one_line
from recon.body.model import BodyModel
from recon.core.arrays import Numbers, bool_tensor, float_tensor, require_shape
from recon.core.errors import ReconError
from recon.core.motion import Motion, MotionFile
from recon.formats.observations import ObservationFile, PositionsFile, load_observation
from recon.formats.opening import load_array
from recon.formats.writing import write_report
from recon.method.protocols import Estimate
from recon.metrics import evaluation
from recon.metrics.evaluation import ObservedPoints, ground_errors, nearest_labels
from recon.reading.points import positions_of

_ON_ITS_GROUND = ("penetration", "sole_penetration", "contact", "slip_speed")
"""How metrics that judge a result by the ground it stands on begin."""


_SHOWN = {
    "joints_all": ("joints, all", 100, "cm"),
    "joints_visible": ("joints that were seen", 100, "cm"),
    "joints_hidden": ("joints that were hidden", 100, "cm"),
    "pa_joints": ("joints after a similarity", 100, "cm"),
    "vertices": ("skin", 100, "cm"),
    "accel_error": ("acceleration", 1, "m/s²"),
    "slip_speed": ("slip of feet in contact", 1, "m/s"),
    "sole_penetration_dist": ("depth of soles below the ground", 100, "cm"),
}
"""Metrics that are printed: words, factor and unit."""


class Evaluation(dict[str, float | None]):
    """Metrics of a reconstruction by name, in SI units; None where one cannot be computed.

    It is a dictionary; printed, it says the most important ones in at most ten lines.
    """

    @property
    def tables(self) -> Tables:
        """All metrics."""
        return {"metrics, SI units": {key: {"value": value} for key, value in self.items()}}

    def report(
        self, inputs: Mapping[str, str] | None = None, _: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The metrics and the checksums of the input files, as values for JSON."""
        return {**self, **closing_fields(inputs, None)}

    def save(
        self,
        path: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the metrics as JSON.

        Args:
            path: file to write.
            overwrite: replace a file that is there and recon did not write.
            report: what to write beside the metrics instead of `report()`.

        Raises:
            FileExistsError: when it is there and recon did not write it, unless `overwrite`.
        """
        write_report(Path(path), {**self, **(report or self.report())}, overwrite=overwrite)

    def __repr__(self) -> str:
        """The most important metrics in at most ten lines."""
        lines = [
            f"{words}: {factor * value:.2f} {unit}"
            for key, (words, factor, unit) in _SHOWN.items()
            if (value := self.get(key)) is not None
        ]
        computed = sum(value is not None for value in self.values())
        first = (
            f"Evaluation: {computed} of {len(self)} metrics could be told, among them errors of"
        )
        return "\n".join([first, *map(one_line, lines)])


def evaluate(
    estimate: MotionLike,
    truth: MotionLike | Numbers,
    body: BodyLike = None,
    *,
    observation: ObservationFile | Path | str | None = None,
    contacts: Numbers | None = None,
    truth_contacts: Numbers | None = None,
    truth_visible: Numbers | None = None,
    observed: ObservedPoints | None = None,
) -> Evaluation:
    """Compare a reconstruction with the true motion; return every metric, in SI units.

    The truth is interpolated at the estimate's times; if it has fewer frames per second, its
    accelerations and jitter are None. `slip_speed` and `slip_speed_truth` are both taken while the
    *truth* is in contact. Heights for `penetration_*` are those of the toe joints less their rest
    height above the sole; `sole_penetration_*` use the lowest point of either foot's skin.
    `w_mpjpe`, `wa_mpjpe`, `rte`, `jitter` and `foot_sliding` are those of papers on video
    (`recon.metrics.world`). The metrics are computed in double precision.

    Where the observation's camera did not know its pose and the simulation kept it
    (`truth_T_world_camera`), errors are taken in the true world, into which the camera carries
    the result: x_true = T_true_camera inv(T_result_camera) x. Contacts, slip and depth below the
    ground stay those of the ground that was found. How far that ground is off in the camera's
    frame are `ground_normal` (radians) and `ground_height` (metres); else they are None.

    Args:
        estimate: the reconstruction, one clip: a motion, a result, a motion file or its arrays.
        truth: the true motion, one clip that lasts at least as long. Or the true joints alone, an
            array (time, 22, 3) in metres at the estimate's frames, or an .npy file of it; errors
            of joints are then all.
        body: of both, each motion has its own shape: a SMPL-family file; default: the bundled
            body.
        observation: the observation file that was fitted, or its path: for errors of its own
            points, and for the joints that a simulated sensor could see.
        contacts: the reconstruction's contacts, (time, 22), labels or probabilities at its
            frames; None takes those of a result or file. Without any, contact accuracy is None.
        truth_contacts: the true ones, at the estimate's frames; None takes those of the truth's
            file, or labels them from the true motion at its own rate.
        truth_visible: true joints the sensor could see, (time, 22), at the estimate's frames.
        observed: the sensor's own points, where no observation is given.

    Raises:
        ReconError: when something is damaged, is a batch, is of another body, or the truth does
            not cover the estimate's times.
        FileNotFoundError: when a file does not exist.
    """
    model = body_given(body).to(dtype=torch.float64)
    ours = _in_double_precision(motion_given(estimate, model, "estimate").file)
    frames = ours.motion.frames
    own = ours.contacts if contacts is None else _labels_as_tensor(contacts, "contacts", frames)
    visible = _checked_visible_joints(truth_visible, frames)
    if isinstance(truth, str | Path) and Path(truth).suffix.lower() == ".npy":
        truth = load_array(Path(truth))
    if hasattr(truth, "__array__") or isinstance(truth, list | tuple):
        of_motion = (observation, contacts, truth_contacts, observed)
        if any(one is not None for one in of_motion):
            raise ReconError(
                "truth: joints alone are compared as they are, so that an observation, its points "
                "and contacts would be ignored: leave them out, or give the true motion"
            )
        return Evaluation(_joint_errors(ours.motion, truth, visible, model))
    theirs = _in_double_precision(motion_given(truth, model, "truth").file)
    seen, path = _read_observation(observation)
    labels = (
        _labels_of_file(theirs, "contacts", ours.motion)
        if truth_contacts is None
        else _labels_as_tensor(truth_contacts, "truth_contacts", frames)
    )
    if visible is None:
        visible = _visible_joints(seen, theirs, ours.motion)
    metrics = evaluation.evaluate(
        ours.motion,
        theirs.motion,
        model,
        contacts=own,
        truth_contacts=labels,
        truth_visible=visible,
        observed=_observed_points(ours, theirs, seen, path, model)
        if observed is None
        else observed,
    ) | {"ground_normal": None, "ground_height": None}
    if (poses := _camera_poses(ours, seen)) is not None:
        found, true = poses
        pelvis = model.rest_joints(ours.motion.shape)[0]
        there = evaluation.evaluate(
            ours.motion.carried(true @ torch.linalg.inv(found), pelvis),
            theirs.motion,
            model,
            truth_contacts=labels,
            truth_visible=visible,
        )
        there |= ground_errors(found, true)
        metrics |= {key: there[key] for key in there if not key.startswith(_ON_ITS_GROUND)}
    return Evaluation(metrics)


def _in_double_precision(file: MotionFile) -> MotionFile:
    """Return a motion file's contents with all floating-point tensors in double precision."""
    return replace(
        file,
        **{
            key: value.double().cpu()
            for key, value in vars(file).items()
            if isinstance(value, Tensor) and value.is_floating_point()
        },
    )


def _joint_errors(
    motion: Motion, true_joints: Any, visible: Bool[Tensor, "time 22"] | None, body: BodyModel
) -> dict[str, float | None]:
    """Return errors of joint positions and accelerations against an array of true joints."""
    truth = float_tensor(true_joints, "truth").double().cpu()
    require_shape(truth, "truth", (motion.frames, 22, 3))
    truth = truth.reshape(motion.frames, 22, 3)
    if not bool(truth.isfinite().all()):
        raise ReconError(
            "truth: holds NaN or infinity; cut these frames out of it and the estimate"
        )
    refuse_other_units("truth", "joints", truth, torch.ones(truth.shape[:-1], dtype=torch.bool))
    joints = body.pose(motion).joints
    return {
        **evaluation.joint_errors(joints, truth, visible),
        **evaluation.smoothness(joints, truth, motion.fps),
        **evaluation.world_errors(joints, truth, motion.fps),
    }


def _labels_as_tensor(given_labels: Numbers, name: str, frames: int) -> Tensor:
    labels = given_labels if isinstance(given_labels, Tensor) else float_tensor(given_labels, name)
    require_shape(labels, name, (frames, 22))
    return labels.cpu()


def _checked_visible_joints(given: Numbers | None, frames: int) -> Bool[Tensor, "time 22"] | None:
    if given is None:
        return None
    visible = bool_tensor(given, "truth_visible")
    require_shape(visible, "truth_visible", (frames, 22))
    return visible.cpu()


def _read_observation(
    given: ObservationFile | Path | str | None,
) -> tuple[ObservationFile | None, Path]:
    """Return an observation, read from its file if a path is given, and a path for messages."""
    if isinstance(given, Path | str):
        return load_observation(given), Path(given)
    return given, Path("observation")


def _labels_of_file(file: MotionFile, name: str, motion: Motion) -> Tensor | None:
    labels = getattr(file, name)
    return None if labels is None else nearest_labels(labels, file.motion.times, motion.times)


def _camera_poses(
    estimate: MotionFile, seen: ObservationFile | None
) -> tuple[Float[Tensor, "4 4"], Float[Tensor, "4 4"]] | None:
    """The estimated and the true T_world_camera; None where either is unknown.

    Raises:
        ReconError: when several poses were found, though the camera stood still.
    """
    if seen is None or isinstance(seen, PositionsFile) or seen.truth_T_world_camera is None:
        return None
    if estimate.T_world_camera is None:
        return None
    if len(estimate.T_world_camera) != 1:
        raise ReconError(
            f"estimate: has {len(estimate.T_world_camera)} poses in T_world_camera, but the "
            "observation is of a camera that stood still; expected one pose"
        )
    true = torch.from_numpy(seen.truth_T_world_camera)
    return estimate.T_world_camera[0].to(true), true


def _visible_joints(
    seen: ObservationFile | None, truth: MotionFile, motion: Motion
) -> Tensor | None:
    """Return which joints the simulated sensor could see, per frame of the given motion."""
    if seen is not None and seen.truth_visible is not None:
        labels = torch.from_numpy(seen.truth_visible)
        times = seen.start_time + torch.arange(len(labels), dtype=torch.float64) / seen.fps
        return nearest_labels(labels, times, motion.times)
    return _labels_of_file(truth, "truth_visible", motion)


def _observed_points(
    estimate: MotionFile,
    truth_file: MotionFile,
    observation: ObservationFile | None,
    path: Path,
    body: BodyModel,
) -> ObservedPoints | None:
    """Return where the observed points are on the estimated and on the true body, by frame."""
    if not isinstance(observation, PositionsFile):
        return None
    adapter = positions_of(observation, path, body.to(dtype=torch.float32))
    truth = truth_file.motion.at(estimate.motion.times, estimate.motion.fps)
    predicted, actual = (
        adapter.predicted(Estimate.of_clip(motion, body))[0] for motion in (estimate.motion, truth)
    )
    seen = torch.from_numpy(observation.visible)
    times = observation.start_time + torch.arange(len(seen), dtype=torch.float64) / observation.fps
    return ObservedPoints(predicted, actual, nearest_labels(seen, times, estimate.motion.times))
