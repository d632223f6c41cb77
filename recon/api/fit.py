"""`recon.fit` and `complete`: from observations of one clip to its motion."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon.api.given import (
    BodyLike,
    Shape,
    ShapeLike,
    body_given,
    checked_prior,
    fixed_shape_or_prior,
    motion_given,
    paths_given,
)
from recon.api.observations import ClipInFitFrame, GroundChoice, ObservationsLike
from recon.api.pipeline import fit_and_check, observations_to_fit
from recon.api.result import Result, Stopper, result_of
from recon.body.model import BodyModel
from recon.core.arrays import finite_number, positive_number, usable_device, usable_frame_rate
from recon.core.errors import ObservationError, ReconError
from recon.core.motion import Motion
from recon.diagnosis.examination import Check
from recon.diagnosis.findings import Finding
from recon.fitting.methods import FitOptions, Method, prior_trait
from recon.fitting.records import Clip
from recon.fitting.settings import ReadOptions
from recon.method.priors import PriorLike
from recon.method.stages import Watch
from recon.method.terms import Term

_LOG = logging.getLogger("recon")

_MOST_NOISE_M = 1.0
"""Largest noise (m) of a coordinate that can be meant; larger numbers are millimetres."""


def fit(
    observations: ObservationsLike,
    prior: str | PriorLike = "humor",
    *,
    weights: str = "open",
    method: Method | None = None,
    body: BodyLike = None,
    shape: ShapeLike | Shape | float | None = None,
    terms: Sequence[Term] = (),
    noise: float | Sequence[float | None] | Mapping[str, float | None] | None = None,
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
    checks: Sequence[Check] | None = None,
    **reading: Any,
) -> Result:
    """Reconstruct the motion that best explains all observations of one clip.

    Observations of any kinds add up, any number of each; each weighs as its noise says, which is
    estimated from the data unless it is given. First guesses, the ground where it is not known,
    recordings of any length and faults of the data are taken care of. The fit computes in single
    precision, uses no random numbers and changes no global setting, so that several may run in
    threads.

    Files and folders are observation files (.npz) of 3D joints, markers, keypoints or points; 3D
    keypoints of FreeMoCap (session folder), MediaPipe, MotionBERT, Azure Kinect, Anipose, Pose2Sim
    or your own (.npy, .npz, .csv, .json, .trc); markers of a laboratory (.c3d, .trc); with a frame
    rate and a camera (which one view of a phone does not need), 2D detections of OpenPose, MMPose,
    AlphaPose, MediaPipe, DeepLabCut, EasyMocap or Pose2Sim (a folder or file per view, or a folder
    of views); a folder of scans (.ply, .pcd, .obj); a folder of 16-bit depth images (.png, with a
    camera). A file of SMPL parameters that a network estimated from video (.pt, .pkl, .npz) is
    refined, as `recon.refine` does.

    Args:
        observations: files and folders of one clip; in Python also one or several of `Joints3D`,
            `Markers3D`, `Keypoints3D`, `Keypoints2D`, `PointCloud`, without a leading axis or with
            one of length one, and what `recon.simulate` returned; or, with `frame_rate`, a list of
            Open3D's point clouds, triangle meshes or pairs (RGBDImage, PinholeCameraIntrinsic),
            one per frame, metres.
        prior: a name (`humor`, `pose`, `anchor` for one gait cycle), a loaded prior, or
            "package.module:Class".
        weights: of a prior given by its name: `open` or a file.
        method: how the prior is fitted, one of its `methods`; `look` gives a preview instead.
        body: a body, a SMPL-family file, or None for the bundled body.
        shape: shape coefficients that are held, or a motion, result or motion file that has them
            (of a static trial, say); or the person's height in metres or a `recon.Shape`, which
            the fit heeds beside the data; None estimates the shape from the data alone.
        terms: further energies, added in all stages that move poses; their weights stand beside
            ½ |residual|² in metres² of the least noisy observation.
        noise: standard deviation of every coordinate, metres or, of keypoints, pixels: one number
            for observations of one unit, or one per observation, None where it is estimated, or
            one per unit, {"metres": 0.02, "pixels": 3.0}.
        robust: metres beyond which a named point counts ever less; `auto` keeps each
            observation's own kernel.
        physics: multiplier of contact and balance energies; 0 leaves them out.
        ground: `auto` as the observations say, and unknown where a camera has no pose; `known` at
            z = 0; `unknown`, to be found; or the plane (nx, ny, nz, d), n·x = d, in the frame of
            the observations, metres. Where it was not known, results are in a world on the ground;
            3D points with z up keep their frame, and `Result.ground` says how high it is. None
            where feet stand on no level ground (water, ropes, stairs): the fit then ignores
            heights, needs a prior that does (`pose`), and finds no contacts.
        between: times from which and up to which to fit, seconds of the observations' clock.
        fps: rate of the result; None is that of the first observation.
        start: a motion, a result or the path of a motion file to begin with, in the frame of the
            observations; it covers the time of one of them.
        device: where stages are minimised, `cpu` or `cuda`; cycles of gait stay on the processor.
        callback: called as callback(stage, progress) after every iteration; True ends the fit.
        max_seconds: time after which the fit is ended. Checks before and after the fit are not
            counted. A fit that is ended early has a warning and its last finite estimate.
        repair: whether what is surely wrong with the data is repaired before the fit.
        checks: what is looked for in the data and in the fit: any of `recon.diagnosis.checks`, and
            functions of your own, in that order; None are all, () is none.
        reading: how to read files, by the names of `recon.fitting.settings.ReadOptions`:
            `frame_rate`, `camera`, `unit`, `up`, `layout`, `person`, ...

    Raises:
        ReconError: for what cannot be fitted or understood; the message says what to do.
        FileNotFoundError: when there is no such file, body, weights or start.
    """
    if torch.is_inference_mode_enabled():
        raise ReconError("a fit needs derivatives: call it outside of torch.inference_mode()")
    if isinstance(observations, Iterator):
        observations = tuple(observations)
    paths = paths_given(observations)
    how_read = ReadOptions.of(reading)
    if paths and _hold_estimated_bodies(paths):
        from recon import refine  # imported here, since `refine` imports this module

        _refuse_unused_options(paths[0], how_read, start)
        return refine(
            paths[0], prior, weights=weights, method=method, body=body, shape=shape,  # pyright: ignore[reportArgumentType]
            frame_rate=how_read.frame_rate, unit=how_read.unit, up=how_read.up,
            hand=how_read.hand, person=how_read.person,  # pyright: ignore[reportArgumentType]
            ground="unknown" if ground == "auto" else ground, terms=terms, noise=noise,
            robust=robust, physics=physics, between=between, fps=fps, device=device,
            callback=callback, max_seconds=max_seconds, checks=checks,
        )  # fmt: skip
    model = body_given(body).to(device="cpu", dtype=torch.float32)
    sighting = observations_to_fit(
        observations, model, how_read, ground=ground, between=between, robust=robust
    )
    clip = sighting.clip
    if fps is not None:
        usable_frame_rate(fps, "fps")
    held, expected = fixed_shape_or_prior(shape, model)
    options = FitOptions(
        prior=checked_prior(prior, weights, method),
        weights=weights,
        method=method,
        noise=_noise_of_each(noise, clip),
        physics=finite_number(physics, "physics"),
        ground_given=clip.ground_given,
        grounded=ground is not None,
        repair=repair,
        shape=held,
        shape_prior=expected,
        terms=tuple(terms),
        device=str(usable_device(device)),
    )
    odd = [one for one in options.terms if not isinstance(one, Term)]
    if odd := odd + [one for one in checks or () if not callable(one)]:
        raise ReconError(f"expected recon.Term in terms, functions in checks; got {odd[0]!r:.60}")
    stopper = None
    if callback is not None or max_seconds is not None:
        limit = None if max_seconds is None else positive_number(max_seconds, "max_seconds")
        stopper = Stopper(callback, limit)
    examined = fit_and_check(
        clip.observations, clip.names, options, model, stopper,
        _start_in_fit_frame(start, sighting, model), checks,
    )  # fmt: skip
    arguments = _options_as_values(options) | {
        "ground": ground, "between": between, "robust": robust, "fps": fps,
        "max_seconds": max_seconds, "device": device,
        "checks": "all" if checks is None else [one.__name__ for one in checks],
    }  # fmt: skip
    stop = _stop_finding(stopper)
    result = result_of(examined, clip, model, fps, options.completes, arguments, stop)
    for finding in (*result.repairs, *result.warnings):
        _LOG.info("%s", finding.message)
    return result


def complete(
    observations: ObservationsLike, prior: str | PriorLike = "recording", **how: Any
) -> Result:
    """Complete a recording with few points or few frames, of any length and any motion.

    Few points of every frame, a few landmarks, few frames at odd times, or all of these: a folder
    of scans (.ply, .pcd) with times.csv or a frame rate, or observations of points, 3D markers or
    joints; several of one clip add up. A motion of 30 Hz or more is fitted to all of them, with
    one shape; under HuMoR unless another prior is given.

    The prior `anchor` fits one whole cycle of gait (0.3 to 3 s, cut out with `between`) as one
    code, from many first guesses, so it takes no `start`. Other motions are completed likewise,
    with a warning; keypoints in images are refused. `Result.cycle` has the cycle's duration in
    seconds, and how far its code is from those of recorded cycles.

    Args:
        observations: as of `recon.fit`: observations, files and folders of one clip.
        prior: `recording`, or a `WholeRecording` with another prior; for one cycle `anchor`, or a
            loaded `AnchorFrames`.
        how: all others of `recon.fit`.

    Raises:
        ReconError: when the data do not show where the body is, at most one moment shows
            anything, or, for one cycle, the data are shorter than a cycle.
        FileNotFoundError: when there is no such file, body or weights.
    """
    if not prior_trait(prior, "completes"):
        raise ReconError(
            f"`recon complete` takes the priors recording and anchor, got {prior}; run `recon fit "
            f"--prior {prior}`"
        )
    return fit(observations, prior, **how)


def _hold_estimated_bodies(paths: Sequence[Path]) -> bool:
    from recon.formats.producers import holds_estimated_bodies  # imported only for files

    return holds_estimated_bodies(paths)


def _refuse_unused_options(path: Path, options: ReadOptions, start: object) -> None:
    """Raise an error for options that have no effect when a file of SMPL parameters is refined."""
    used_options = ("frame_rate", "unit", "up", "hand", "person")
    given = [name for name in options.changed_names() if name not in used_options]
    given += [] if start is None else ["start"]
    if given:
        raise ReconError(
            f"{path}: is an estimate of a motion, for which {', '.join(given)} mean nothing; "
            "leave them out"
        )


def _noise_of_each(
    given: float | Sequence[float | None] | Mapping[str, float | None] | None, clip: Clip
) -> tuple[float | None, ...]:
    """Return the user's noise for every observation, None where it is to be estimated."""
    if given is None:
        return ()
    if isinstance(given, Mapping):
        given = [given.get(one.unit) for one in clip.observations]
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
    usable = tuple(None if one is None else positive_number(one, "noise") for one in given)
    for deviation, name, seen in zip(usable, clip.names, clip.observations, strict=True):
        if seen.unit == "metres" and (deviation or 0.0) > _MOST_NOISE_M:
            raise ObservationError(
                f"noise: expected at most {_MOST_NOISE_M:g} m for {name}, got {deviation:g}; it "
                "is in metres: 20 mm are 0.02"
            )
    return usable


def _start_in_fit_frame(
    given: Motion | Result | Path | str | None, clip: ClipInFitFrame, body: BodyModel
) -> Motion | None:
    """Return the caller's initial motion with a batch axis, in the coordinates of the fit."""
    if given is None:
        return None
    if not isinstance(given, Motion | Result):
        given = motion_given(given, body, "start").motion
    motion = given.motion if isinstance(given, Result) else given
    if motion.translation.ndim == 2:
        motion = motion[None]
    T = clip.T_recording_given
    if T is None or motion.shape.shape[-1] > body.shape_size:
        return motion
    like = motion.translation
    pelvis = body.rest_joints(motion.shape.to(body.template))[..., 0, :].to(like)
    return motion.carried(torch.from_numpy(np.asarray(T)).to(like), pelvis)


def _stop_finding(stopper: Stopper | None) -> Finding | None:
    if stopper is None or stopper.reason is None:
        return None
    return Finding(
        "stopped",
        f"the fit was ended by {stopper.reason} before it was done; the motion is the estimate "
        "so far",
    )


def _options_as_values(options: FitOptions) -> dict[str, Any]:
    """Return the options of a fit as values that JSON can hold, for the report."""
    prior, shape, expected = options.prior, options.shape, options.shape_prior
    return {
        "prior": prior if isinstance(prior, str) else type(prior).__name__,
        "weights": options.weights,
        "method": options.method if options.method is None else str(options.method),
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
