"""`recon.refine`: a motion that another program estimated, as a person would have moved."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from recon.api.fit import fit
from recon.api.given import BodyLike, MotionLike, ShapeLike, body_given, motion_given, shape_given
from recon.api.result import Result
from recon.body.model import BodyModel
from recon.core.arrays import positive
from recon.core.errors import ReconError
from recon.core.limits import FRAME_RATE
from recon.core.motion import Motion
from recon.core.units import Axis
from recon.diagnosis.estimates import believed
from recon.fitting.methods import PriorObject
from recon.formats.estimates import BodyEstimate, read_estimate
from recon.formats.opening import load_arrays
from recon.method.stages import Watch

_LEAST_FRAMES = 4


def refine(
    motion: MotionLike,
    prior: str | PriorObject = "humor",
    *,
    weights: str = "open",
    body: BodyLike = None,
    shape: ShapeLike | None = None,
    frame_rate: float | None = None,
    fps: float | None = None,
    up: Axis | None = None,
    person: int | None = None,
    ground: str = "unknown",
    physics: float = 0.0,
    device: str = "cpu",
    callback: Watch | None = None,
    max_seconds: float | None = None,
) -> Result:
    """The motion behind an estimate of it: feet that stand, no jitter, impacts kept.

    Networks that look at video err for seconds, by limb, and their path drifts; here residuals
    are weighed by the inverse of their covariance in time, so that fast changes are believed and
    lasting deviations are cheap. Limbs that are exchanged for moments are put right, stretches
    between jumps err each for itself. Left-out frames are filled.

    Args:
        motion: a motion, a result, a motion file, or a file of GVHMR, WHAM, SLAHMR, SMPL-X or
            AMASS parameters (.npz, .pt, .pkl; nothing inside is run).
        prior: as in `recon.fit`.
        weights: as in `recon.fit`.
        body: the body that the estimate is of, a SMPL-family file of which the shape coefficients
            are then taken; or None for the bundled body.
        shape: of the person, as `recon.retarget` takes it ("height=1.80"), on the bundled body,
            for which coefficients of another body model mean nothing; None is the average shape.
        frame_rate: frames per second of an estimate that does not say it.
        fps: rate of the result; None is the estimate's.
        up: axis of the estimate's world that points up; None tells it from how the body stands.
        person: which of several people in a file, from 1 on; None takes the one of most frames.
        ground: `unknown`, to be found; or `known` at height zero of the estimate's world.
        physics: as in `recon.fit`.
        device: as in `recon.fit`.
        callback: as in `recon.fit`.
        max_seconds: as in `recon.fit`.

    Raises:
        ReconError: when the estimate is damaged, no estimate, lasts less than four frames, or its
            frame rate is missing.
        FileNotFoundError: when there is no such file.
    """
    if ground not in ("known", "unknown"):
        raise ReconError(f"ground: expected known or unknown, got {ground!r}")
    model = body_given(body)
    given, known, notes = _given(motion, model, body is not None, shape, frame_rate, up, person)
    if given.frames < _LEAST_FRAMES:
        raise ReconError(
            f"expected an estimate of at least {_LEAST_FRAMES} frames, got {given.frames}"
        )
    estimate = believed(given, known, model)
    seen = estimate.seen.replace(ground_known=ground == "known")
    result = fit(
        seen, prior, weights=weights, body=model, shape=given.shape, physics=physics, fps=fps,
        start=estimate.motion, device=device, callback=callback, max_seconds=max_seconds,
        repair=False,
    )  # fmt: skip
    repairs = (*estimate.repairs, *result.repairs)
    return replace(
        result,
        notes=(*notes, *result.notes),
        examined=replace(result.examined, repairs=repairs),
    )


def _given(
    motion: MotionLike,
    body: BodyModel,
    own_body: bool,
    shape: ShapeLike | None,
    frame_rate: float | None,
    up: Axis | None,
    person: int | None,
) -> tuple[Motion, Bool[Tensor, " time"], tuple[str, ...]]:
    """The estimate on a body in a world with z up, which frames there are, what was assumed."""
    known_shape = None if shape is None else shape_given(shape, body)
    if not isinstance(motion, Path | str) or _of_this_body(Path(motion), body):
        found = motion_given(motion, body).motion
        if known_shape is not None:
            found = found.replace(shape=known_shape)
        return found, torch.ones(found.frames, dtype=torch.bool), ()
    read = read_estimate(Path(motion), person, up)
    rate = read.fps if frame_rate is None else frame_rate
    if rate is None:
        raise ReconError(
            f"{motion}: does not say how many frames there are per second; give frame_rate "
            "(--frame-rate), that of the video"
        )
    FRAME_RATE.check(positive(rate, "frame_rate"), "refine", "frame_rate")
    coefficients, words = _shape(read, body, own_body, known_shape)
    placed = Motion.create(
        torch.from_numpy(read.translation).float(),
        torch.from_numpy(read.rotations).float(),
        coefficients,
        fps=rate,
    )
    pelvis = body.rest_joints(coefficients)[0]
    upright = placed.carried(torch.from_numpy(_to_z(read.up)).float(), pelvis)
    return upright, torch.from_numpy(read.known), (*read.notes, *words)


def _of_this_body(path: Path, body: BodyModel) -> bool:
    """Whether a file says that its shape coefficients are of this body."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    arrays = load_arrays(path)
    return "body_checksum" in arrays and str(arrays["body_checksum"]) == body.checksum


def _shape(
    read: BodyEstimate, body: BodyModel, own_body: bool, given: Tensor | None
) -> tuple[Tensor, tuple[str, ...]]:
    """The shape that is held: as given, the file's on a body of the user's, or the average."""
    if given is not None:
        return given, ()
    if own_body:
        count = min(len(read.betas), body.shape_size)
        found = body.template.new_zeros(body.shape_size)
        found[:count] = torch.from_numpy(read.betas[:count]).to(found)
        return found, ()
    return body.template.new_zeros(body.shape_size), (
        "its shape coefficients are of another body model and mean nothing on this one: the "
        "average body is taken; give the person's shape (--shape height=1.80), or the body model "
        "(--body)",
    )


def _to_z(up: tuple[int, Axis]) -> np.ndarray:
    """The turn by the least angle that brings an axis to z."""
    sign, axis = up
    T = np.eye(4)
    if axis == "y":
        T[:3, :3] = [[1, 0, 0], [0, 0, -sign], [0, sign, 0]]
    elif axis == "x":
        T[:3, :3] = [[0, 0, -sign], [0, 1, 0], [sign, 0, 0]]
    elif sign < 0:
        T[:3, :3] = np.diag([1.0, -1.0, -1.0])
    return T
