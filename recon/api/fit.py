"""`recon.fit`: whatever was observed of one clip in, the motion behind it out."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon.api.given import (
    BodyLike,
    Shape,
    ShapeLike,
    body_given,
    motion_given,
    prior_of,
    shape_known,
)
from recon.api.observations import GroundChoice, ObservationsLike, Sighting
from recon.api.pipeline import fitted, observed
from recon.api.result import Result, Stopper, result_of
from recon.body.model import BodyModel
from recon.core.arrays import finite, positive
from recon.core.errors import ObservationError
from recon.core.limits import FRAME_RATE
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding
from recon.fitting.methods import FitOptions, PriorObject
from recon.fitting.observed import Clip
from recon.method.stages import Watch
from recon.method.terms import Term

_LOG = logging.getLogger("recon")


def fit(
    observations: ObservationsLike,
    prior: str | PriorObject = "humor",
    *,
    weights: str = "open",
    method: str | None = None,
    body: BodyLike = None,
    shape: ShapeLike | Shape | float | None = None,
    terms: Sequence[Term] = (),
    noise: float | Sequence[float | None] | None = None,
    robust: float | str = "auto",
    physics: float = 0.0,
    ground: GroundChoice = "auto",
    between: tuple[float, float] | None = None,
    fps: float | None = None,
    start: Motion | Result | Path | str | None = None,
    device: str = "cpu",
    callback: Watch | None = None,
    max_seconds: float | None = None,
    repair: bool = True,
) -> Result:
    """The motion that explains all observations of one clip and is likely under the prior.

    Observations of any kinds add up; each weighs as its noise says, which is estimated from the
    data unless it is given. First guesses, the ground where it is not known, recordings of any
    length and faults of the data are taken care of. The fit computes in single precision, uses no
    random numbers and changes no global setting, so that several may run in threads.

    Args:
        observations: one or several of `Joints3D`, `Markers3D`, `Keypoints2D`, `PointCloud`,
            without a leading axis or with one of length one; `recon.load_observation` reads them
            from files. Or paths of such files and folders, or what `recon.simulate` returned.
        prior: a name (`humor`, `pose`, `anchor` for one gait cycle), a loaded prior, a
            method with `stages(data)`, or "package.module:Class".
        weights: of a prior given by its name: `open`, `nc` (not for commercial use) or a file.
        method: the way in which the prior is fitted, one of its `methods`; None is the usual one.
            `humor` has `collocation` (the motion itself is moved; usual) and `rollout` (a first
            state and latents, through the decoder's roll-out).
        body: a body, a SMPL-family file, or None for the bundled body.
        shape: shape coefficients that are held, or a motion, result or motion file that has them
            (of a static trial, say); or the person's height in metres or a `recon.Shape`, which
            the fit heeds beside the data; None estimates the shape from the data alone.
        terms: further energies, added in all stages that move poses; their weights stand beside
            ½ |residual|² in metres² of the least noisy observation.
        noise: standard deviation of every coordinate, metres or, of keypoints, pixels: one number
            for observations of one unit, or one per observation, None where it is estimated.
        robust: metres beyond which a named point counts ever less; `auto` keeps each
            observation's own kernel.
        physics: multiplier of contact and balance energies; 0 leaves them out.
        ground: `auto` as the observations say, and unknown where a camera has no pose; `known` at
            z = 0; `unknown`, to be found; or the plane (nx, ny, nz, d), n·x = d, in the frame of
            the observations, metres. Where it was not known, results are in a world on the ground;
            3D points with z up keep their frame, and `Result.ground` says how high it is. None
            where there is no ground that feet stand on (water, ropes, stairs): nothing is judged
            by heights, so the prior must not (`pose` does not), and no contacts are told.
        between: times from which and up to which to fit, seconds of the observations' clock.
        fps: rate of the result; None is that of the first observation.
        start: a motion, a result or the path of a motion file to begin with, in the frame of the
            observations; it covers the time of one of them.
        device: where to compute, `cpu` or `cuda`.
        callback: called as callback(stage, progress) after every iteration; True ends the fit.
        max_seconds: time after which the fit is ended. Checks before and after the fit are not
            counted. A fit that is ended early has a warning and its last finite estimate.
        repair: whether what is surely wrong with the data is repaired before the fit.

    Raises:
        ReconError: for what cannot be fitted or understood; the message says what to do.
        FileNotFoundError: when there is no such body, weights or start.
    """
    model = body_given(body).to(device=device, dtype=torch.float32)
    sighting = observed(observations, model, ground=ground, between=between, robust=robust)
    clip = sighting.clip
    if fps is not None:
        FRAME_RATE.check(positive(fps, "fps"), "fit", "fps")
    held, expected = shape_known(shape, model)
    options = FitOptions(
        prior=prior_of(prior, weights, method),
        weights=weights,
        method=method,
        noise=_noises(noise, clip),
        physics=finite(physics, "physics"),
        ground_given=clip.ground_given,
        grounded=ground is not None,
        repair=repair,
        shape=held,
        shape_prior=expected,
        terms=tuple(terms),
    )
    stopper = None
    if callback is not None or max_seconds is not None:
        limit = None if max_seconds is None else positive(max_seconds, "max_seconds")
        stopper = Stopper(callback, limit)
    examined = fitted(
        clip.observations, clip.names, options, model, stopper, _start(start, sighting, model)
    )
    arguments = _plain(options) | {
        "ground": ground, "between": between, "robust": robust, "fps": fps,
        "max_seconds": max_seconds, "device": device,
    }  # fmt: skip
    result = result_of(
        examined, clip, model.to(device="cpu"), fps, options.completes, arguments,
        _stopped(stopper),
    )  # fmt: skip
    for finding in (*result.repairs, *result.warnings):
        _LOG.info("%s", finding.message)
    return result


def _noises(given: float | Sequence[float | None] | None, clip: Clip) -> tuple[float | None, ...]:
    """One for every observation; empty where all are estimated."""
    if given is None:
        return ()
    count = len(clip.observations)
    if not isinstance(given, Sequence):
        units = sorted({one.unit for one in clip.observations})
        if len(units) > 1:
            raise ObservationError(
                f"noise: some observations are in {' and some in '.join(units)}; give one number "
                f"for each of {', '.join(clip.names)}, None where it is to be estimated"
            )
        given = [given] * count
    if len(given) != count:
        raise ObservationError(
            f"noise: expected one number, or {count}, one for each of {', '.join(clip.names)}; "
            f"got {len(given)}"
        )
    return tuple(None if one is None else positive(one, "noise") for one in given)


def _start(
    given: Motion | Result | Path | str | None, sighting: Sighting, body: BodyModel
) -> Motion | None:
    """The caller's start with a leading axis, in the frame in which observations are fitted."""
    if given is None:
        return None
    if isinstance(given, Path | str):
        given = motion_given(given, body, "start").motion
    motion = given.motion if isinstance(given, Result) else given
    if motion.translation.ndim == 2:
        motion = motion.map(lambda tensor: tensor[None])
    T = sighting.T_recording_given
    if T is None or motion.shape.shape[-1] > body.shape_size:
        return motion
    like = motion.translation
    pelvis = body.rest_joints(motion.shape.to(body.template))[..., 0, :].to(like)
    return motion.carried(torch.from_numpy(np.asarray(T)).to(like), pelvis)


def _stopped(stopper: Stopper | None) -> Finding | None:
    if stopper is None or stopper.reason is None:
        return None
    return Finding(
        "stopped",
        f"the fit was ended by {stopper.reason} before it was done; the motion is the estimate "
        "so far",
    )


def _plain(options: FitOptions) -> dict[str, Any]:
    """Options as a report holds them."""
    prior, shape, expected = options.prior, options.shape, options.shape_prior
    return {
        "prior": prior if isinstance(prior, str) else type(prior).__name__,
        "weights": options.weights,
        "method": options.method,
        "noise": list(options.noise),
        "physics": options.physics,
        "repair": options.repair,
        "shape": None if shape is None else shape.tolist(),
        "shape_prior": None
        if expected is None
        else {
            "height": expected.height,
            "height_std": expected.height_std,
            "like": expected.mean.tolist(),
            "like_std": expected.std,
        },
        "terms": {term.name: term.weight for term in options.terms},
    }
