"""Checks and evaluates the answer of a method for a window: a motion or joint positions."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.api.given import motion_given
from recon.benchmark.protocols import BenchProtocol, SeenWindow
from recon.benchmark.windows import TrueWindows
from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import FEET, LEGS
from recon.formats.opening import load_arrays
from recon.metrics import errors as metrics
from recon.metrics.evaluation import (
    ObservedPoints,
    evaluate,
    joint_errors,
    observed_errors,
    smoothness,
    sole_heights,
)
from recon.metrics.world import world_errors

Row = dict[str, float | None]
"""Values by metric of one window, in SI units; None where it has none."""


def sole_height_in_contact(
    motion: Motion, touching: Bool[Tensor, "time 22"], body: BodyModel
) -> float | None:
    """Return the mean distance of the soles of feet in contact from the ground z = 0, metres."""
    # a foot stands where its ankle or its toes touch the ground; axes: time, left and right
    stands = touching[:, list(FEET)].unflatten(-1, (2, 2)).any(-2)
    return metrics.mean(sole_heights(body.pose(motion)).abs(), stands)


def feet_balanced_accuracy(
    windows: TrueWindows, predicted: Bool[Tensor, "clips time 22"]
) -> float | None:
    """Balanced accuracy of ankle and toe contacts, averaged over subjects.

    The accuracy of a subject is computed over all its windows together.
    """
    accuracies: list[float] = []
    for subject in windows.averaged_subjects:
        own = [i for i, one in enumerate(windows.subjects) if one == subject]
        value = metrics.contact_balanced_accuracy(predicted[own], windows.contacts[own], FEET)
        if value is not None:
            accuracies.append(value)
    return float(np.mean(accuracies)) if accuracies else None


ARRAYS = ("joints", "points", "contacts")
"""Keys of an answer in arrays: joints (time, 22, 3), points as they were seen (time, points, 3),
both in metres, and probabilities of contact (time, 22). Joints are needed."""


@dataclass(frozen=True)
class Answer:
    """The checked output of a benchmark method for one window; tensors have a row per frame."""

    joints: Float[Tensor, "time 22 3"]
    motion: Motion | None = None
    points: Float[Tensor, "time points 3"] | None = None
    contacts: Float[Tensor, "time 22"] | None = None
    """Probabilities of contact, labelled from a motion whose method says nothing of them; None
    for joints alone."""


def answer_of(output: Any, window: SeenWindow, body: BodyModel, name: str) -> Answer:
    """Check the output of a method for one window, and make an `Answer` of it.

    Args:
        output: places of the 22 joints, an array (time, 22, 3) in metres; a mapping of such arrays
            by the names in `ARRAYS`; or a motion, as every function of recon takes it.
        window: for which it was given.
        body: whose motions are judged.
        name: of the method or file, for messages.

    Raises:
        ReconError: when it is none of these, has other frames than the window, or holds NaN.
    """
    where = f"{name}, window {window.name}"
    if isinstance(output, Mapping) and set(output) & set(ARRAYS):
        return _answer_of_arrays(output, window, where)
    if hasattr(output, "__array__") or isinstance(output, list):
        return _answer_of_arrays({"joints": output}, window, where)
    file = motion_given(output, body, where).file
    motion, truth = file.motion, window.truth
    if motion.frames != truth.frames or abs(motion.fps - truth.fps) > 1e-3:
        raise ReconError(
            f"{where}: expected {truth.frames} frames at {truth.fps:g} Hz, got {motion.frames} "
            f"at {motion.fps:g} Hz"
        )
    motion = motion.replace(start_time=truth.start_time, fps=truth.fps)
    posed = body.pose(motion)
    points = posed.points(torch.tensor(window.vertices)) if window.vertices else None
    contacts = file.contacts
    if contacts is None:
        heights = rest_heights(body, motion.shape)
        contacts = contact_labels(posed.joints, heights, motion.fps).double()
    return Answer(posed.joints, motion, points, contacts)


def answer_from_folder(folder: Path, window: SeenWindow, body: BodyModel) -> Answer:
    """Read the prediction for a window in a folder: a motion file, or arrays.

    Raises:
        FileNotFoundError: when the folder has no file of the window's name.
        ReconError: when it is damaged, or as `answer_of` says.
    """
    path = folder / window.file_name
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: expected a prediction for every window, in files named as those of "
            "`recon bench PROTOCOL --write FOLDER`"
        )
    arrays = load_arrays(path)
    own = {key: arrays[key] for key in ARRAYS if key in arrays}
    if len(own) == 0 and "trans" not in arrays:
        raise ReconError(
            f"{path}: expected a motion file, or an array joints (time, 22, 3) in metres; found "
            f"{', '.join(sorted(arrays))}"
        )
    return answer_of(own or path, window, body, str(folder))


def _answer_of_arrays(given: Mapping[str, Any], window: SeenWindow, where: str) -> Answer:
    if unknown := sorted(set(given) - set(ARRAYS)):
        raise ReconError(f"{where}: expected arrays {', '.join(ARRAYS)}; got also {unknown}")
    if "joints" not in given:
        raise ReconError(f"{where}: expected joints (time, 22, 3) beside {', '.join(given)}")
    time = window.truth.frames
    shapes = {
        "joints": (time, 22, 3),
        "points": tuple(window.points.shape),
        "contacts": (time, 22),
    }
    tensors: dict[str, Tensor] = {}
    for key, value in given.items():
        array = np.asarray(value)
        if array.shape != shapes[key] or array.dtype.kind not in "fiub":
            raise ReconError(
                f"{where}: expected {key} of shape {shapes[key]}, metres, z up; got "
                f"{array.shape} of {array.dtype}"
            )
        if not np.isfinite(array).all():
            raise ReconError(f"{where}: {key} holds NaN or infinity; every frame needs a value")
        tensors[key] = torch.from_numpy(array.astype(np.float64))
    points = tensors.get("points") if window.vertices else None
    return Answer(tensors["joints"], points=points, contacts=tensors.get("contacts"))


def metrics_of_answer(
    protocol: BenchProtocol, window: SeenWindow, answer: Answer, body: BodyModel
) -> Row:
    """Metrics of a method's answer over the frames that a protocol evaluates, in SI units."""
    judged_frames = slice(*protocol.judged)
    truth = window.truth.window(*protocol.judged)
    touching = window.touching[judged_frames]
    contacts = None if answer.contacts is None else answer.contacts[judged_frames]
    observed = None
    if answer.points is not None:
        visible = torch.from_numpy(window.seen.visible)[judged_frames]
        places = window.points[judged_frames].double()
        observed = ObservedPoints(answer.points[judged_frames].double(), places, visible)
    if answer.motion is not None:
        motion = answer.motion.window(*protocol.judged)
        row = evaluate(
            motion, truth, body, contacts=contacts, truth_contacts=touching, observed=observed
        )
        for name, one in (("sole_height", motion), ("sole_height_truth", truth)):
            row[name] = sole_height_in_contact(one, touching, body)
        return row
    own, actual = answer.joints[judged_frames], body.pose(truth).joints.double()
    errors = metrics.point_errors(own, actual)
    return {
        **joint_errors(own, actual, None),
        "joints_legs": metrics.mean(errors[:, list(LEGS)]),
        **smoothness(own, actual, truth.fps),
        **world_errors(own, actual, truth.fps),
        **observed_errors(observed),
        "slip_speed": metrics.slip_speed(own, touching, truth.fps),
    }
