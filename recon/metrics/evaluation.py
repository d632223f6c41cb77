"""Compares a reconstruction with the true motion: every metric in a flat table."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel, PosedBody
from recon.core.camera import Ground
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import LEGS, TOES
from recon.core.struct import TensorStruct
from recon.metrics import errors as metrics
from recon.metrics.world import world_errors

_CHUNK = 64
"""Frames whose surfaces are compared at once, to bound memory."""

_FEET = ((7, 10), (8, 11))
"""Joints whose skin is the left and the right foot."""


@dataclass(frozen=True)
class ObservedPoints(TensorStruct):
    """Predicted and true points that a sensor measures, at its frame times; world, metres."""

    predicted: Float[Tensor, "moments points 3"]
    truth: Float[Tensor, "moments points 3"]
    visible: Bool[Tensor, "moments points"]
    """Points the observation holds; the others were hidden from the reconstruction."""


def evaluate(
    estimate: Motion,
    truth: Motion,
    body: BodyModel,
    *,
    contacts: Shaped[Tensor, "time 22"] | None = None,
    truth_contacts: Shaped[Tensor, "time 22"] | None = None,
    truth_visible: Bool[Tensor, "time 22"] | None = None,
    observed: ObservedPoints | None = None,
) -> dict[str, float | None]:
    """Return all metrics of one clip in SI units, by name; None where one cannot be computed.

    The truth is interpolated at the estimate's times; if it has fewer frames per second, its
    accelerations and jitter are None. Contacts and visibility are given at the
    estimate's frames (`nearest_labels` brings recorded ones there); contacts are labels or
    probabilities. `slip_speed` and `slip_speed_truth` are both taken while the *truth* is in
    contact. Heights for `penetration_*` are those of the toe joints less their rest height above
    the sole; `sole_penetration_*` use the lowest point of either foot's skin.

    Args:
        estimate: The reconstruction, one clip.
        truth: The true motion, one clip that lasts at least as long.
        body: Of both; each motion has its own shape.
        contacts: The reconstruction's contacts. Without them contact accuracy is None.
        truth_contacts: Labelled from the true motion at its own rate if not given.
        truth_visible: True joints the sensor could see.
        observed: The sensor's own points.

    Raises:
        ValueError: when a motion is a batch, the estimate reaches beyond the truth, or they have
            no frame in common.
    """
    device = estimate.translation.device
    body = body.to(device=device, dtype=torch.float64)
    estimate, truth = (m.to(device=device, dtype=torch.float64) for m in (estimate, truth))
    aligned, count = _common_frames(estimate, truth)
    if truth_contacts is None:
        truth_contacts = nearest_labels(
            contact_labels(body.pose(truth).joints, rest_heights(body, truth.shape), truth.fps),
            truth.times,
            estimate.times,
        )
    estimate = estimate.window(0, count)
    predicted, actual = body.pose(estimate), body.pose(aligned)
    touching = _as_labels(truth_contacts)[:count]
    visible = None if truth_visible is None else truth_visible[:count]
    return {
        **joint_errors(predicted.joints, actual.joints, visible),
        **observed_errors(observed),
        "vertices": _vertex_error(predicted, actual),
        **smoothness(predicted.joints, actual.joints, estimate.fps),
        **world_errors(predicted.joints, actual.joints, estimate.fps),
        **_contact_metrics(None if contacts is None else _as_labels(contacts)[:count], touching),
        **_penetration_metrics("penetration", _toe_heights(predicted), _toe_heights(actual)),
        **_penetration_metrics("sole_penetration", sole_heights(predicted), sole_heights(actual)),
        "slip_speed": metrics.slip_speed(predicted.joints, touching, estimate.fps),
        "slip_speed_truth": metrics.slip_speed(actual.joints, touching, estimate.fps),
        # interpolated linearly, a coarser truth has the accelerations of kinks
        **dict.fromkeys(
            ("accel_truth", "accel_error", "jitter_truth")
            if truth.fps < 0.99 * estimate.fps
            else ()
        ),
    }


def ground_errors(found: Float[Tensor, "4 4"], true: Float[Tensor, "4 4"]) -> dict[str, float]:
    """Return errors of an estimated ground: of its normal (radians) and camera height (metres).

    Args:
        found: T_world_camera of the estimate.
        true: T_world_camera of the truth.
    """
    ours, theirs = (Ground.seen_from(torch.linalg.inv(T)) for T in (found, true))
    across = torch.linalg.cross(ours.normal, theirs.normal).norm()
    angle = torch.atan2(across, (ours.normal * theirs.normal).sum())
    return {
        "ground_normal": float(angle),
        "ground_height": float((ours.offset - theirs.offset).abs()),
    }


def nearest_labels(
    labels: Shaped[Tensor, "recorded points"],
    label_times: Float[Tensor, " recorded"],
    times: Float[Tensor, " time"],
) -> Shaped[Tensor, "time points"]:
    """Return labels at given times, from the nearest recorded frame (of two, the earlier)."""
    after = torch.searchsorted(label_times, times).clamp(1, max(len(label_times) - 1, 1))
    before = after - 1
    after = after.clamp(max=len(label_times) - 1)
    later = (label_times[after] - times) < (times - label_times[before])
    return labels[torch.where(later, after, before)]


def _common_frames(estimate: Motion, truth: Motion) -> tuple[Motion, int]:
    """Return the true motion at the estimate's times, and the number of frames valid in both."""
    for name, motion in (("estimate", estimate), ("truth", truth)):
        if motion.translation.dim() != 2:
            raise ReconError(
                f"expected one clip as {name}, got a batch of shape "
                f"{tuple(motion.translation.shape[:-2])}; evaluate its clips one by one"
            )
    count = int((estimate.valid.long().cumprod(0)).sum())
    if count == 0:
        raise ReconError("the estimate has no valid frame, so there is nothing to evaluate")
    try:
        aligned = truth.at(estimate.times[:count], estimate.fps)
    except ValueError as error:
        raise ReconError(f"the truth does not cover the estimate: {error}") from error
    count = int(aligned.valid.long().cumprod(0).sum())
    if count == 0:
        raise ReconError("the truth has no valid frame at the estimate's times; check both clocks")
    return aligned.window(0, count), count


def _as_labels(contacts: Tensor) -> Tensor:
    return contacts if contacts.dtype == torch.bool else contacts > 0.5


def joint_errors(
    predicted: Float[Tensor, "time 22 3"],
    truth: Float[Tensor, "time 22 3"],
    visible: Bool[Tensor, "time 22"] | None,
) -> dict[str, float | None]:
    """Return mean joint errors (m): in the world, relative to the pelvis, after a similarity."""
    world = metrics.point_errors(predicted, truth)
    rooted = metrics.point_errors(metrics.root_aligned(predicted), metrics.root_aligned(truth))
    similar = metrics.point_errors(metrics.similarity_aligned(predicted, truth), truth)
    return {
        "joints_all": metrics.mean(world),
        "joints_legs": metrics.mean(world[:, list(LEGS)]),
        "joints_visible": None if visible is None else metrics.mean(world, visible),
        "joints_hidden": None if visible is None else metrics.mean(world, ~visible),
        "root_joints_all": metrics.mean(rooted),
        "root_joints_visible": None if visible is None else metrics.mean(rooted, visible),
        "root_joints_hidden": None if visible is None else metrics.mean(rooted, ~visible),
        "pa_joints": metrics.mean(similar),
    }


def observed_errors(observed: ObservedPoints | None) -> dict[str, float | None]:
    """Return mean errors of a sensor's points: of all, of visible and of hidden ones; metres."""
    if observed is None:
        return dict.fromkeys(("observed_all", "observed_visible", "observed_hidden"))
    errors = metrics.point_errors(observed.predicted, observed.truth)
    return {
        "observed_all": metrics.mean(errors),
        "observed_visible": metrics.mean(errors, observed.visible),
        "observed_hidden": metrics.mean(errors, ~observed.visible),
    }


def _vertex_error(predicted: PosedBody, truth: PosedBody) -> float | None:
    everything = torch.arange(len(predicted.model.template), device=predicted.joints.device)
    errors = [
        metrics.point_errors(a.points(everything), b.points(everything)).mean(-1)
        for a, b in zip(_frame_chunks(predicted), _frame_chunks(truth), strict=True)
    ]
    return metrics.mean(torch.cat(errors))


def _frame_chunks(posed: PosedBody) -> list[PosedBody]:
    starts = range(0, len(posed.joints), _CHUNK)
    parts = [slice(start, start + _CHUNK) for start in starts]
    return [
        PosedBody(
            model=posed.model,
            shape=posed.shape,
            rest=posed.rest,
            local=posed.local[part],
            joints=posed.joints[part],
            orientations=posed.orientations[part],
        )
        for part in parts
    ]


def smoothness(
    predicted: Float[Tensor, "time points 3"], truth: Float[Tensor, "time points 3"], fps: float
) -> dict[str, float | None]:
    """Mean accelerations of predicted and true points, and their error, m/s²."""
    a, b = metrics.accelerations(predicted, fps), metrics.accelerations(truth, fps)
    return {
        "accel": metrics.mean(a.norm(dim=-1)),
        "accel_truth": metrics.mean(b.norm(dim=-1)),
        "accel_error": metrics.mean(metrics.point_errors(a, b)),
    }


def _contact_metrics(contacts: Tensor | None, truth: Tensor) -> dict[str, float | None]:
    if contacts is None:
        return {"contact_accuracy": None, "contact_balanced": None}
    return {
        "contact_accuracy": metrics.contact_accuracy(contacts, truth),
        "contact_balanced": metrics.contact_balanced_accuracy(contacts, truth),
    }


def _penetration_metrics(name: str, predicted: Tensor, truth: Tensor) -> dict[str, float | None]:
    return {
        f"{name}_freq": metrics.penetration_frequency(predicted),
        f"{name}_dist": metrics.penetration_distance(predicted),
        f"{name}_freq_truth": metrics.penetration_frequency(truth),
    }


def _toe_heights(posed: PosedBody) -> Tensor:
    """Height of the toe joints above their height on a flat standing foot, metres."""
    toes = list(TOES)
    return posed.joints[:, toes, 2] - rest_heights(posed.model, posed.shape)[toes]


def sole_heights(posed: PosedBody) -> Float[Tensor, "time 2"]:
    """Height of the lowest skin point of each foot in every frame, metres."""
    owner = posed.model.weights.argmax(-1)
    feet = [torch.isin(owner, owner.new_tensor(joints)).nonzero()[:, 0] for joints in _FEET]
    return torch.stack([posed.points(foot)[..., 2].amin(-1) for foot in feet], -1)
