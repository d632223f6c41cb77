"""The steps of a fit, from the observations of one clip to a motion with checks and uncertainty.

`recon.fit` says what its arguments mean, calls `observations_to_fit` and `fit_and_check`, and
describes the result.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from observations.first_guess import with_first_guess
from recon.api.given import paths_given
from recon.api.observations import ClipInFitFrame, clip_of, in_fit_frame, with_robust_kernel
from recon.body.model import BodyModel
from recon.core.arrays import finite_number, geometries_given
from recon.core.errors import ObservationError, ReconError
from recon.core.motion import Motion
from recon.diagnosis.examination import Check, CheckedClip, ExaminedClip, checked
from recon.fitting.clip import clip_problem
from recon.fitting.methods import FitOptions, is_preview, loaded_prior
from recon.fitting.records import ClipFit, clip_between, seen_times
from recon.fitting.settings import FitSettings, ReadOptions
from recon.method.pace import paced
from recon.method.sensor import Sensor, views_of
from recon.method.stages import Watch


def observations_to_fit(
    given: Any,
    body: BodyModel,
    how_read: ReadOptions,
    *,
    ground: Any = "auto",
    between: tuple[float, float] | None = None,
    robust: float | str = "auto",
) -> ClipInFitFrame:
    """Read the observations of one clip and bring them to the coordinates of the fit.

    Args:
        given: as `recon.fit` takes it.
        body: that is to be fitted; observations get its precision and device.
        how_read: options of reading files; none may be set for observations in memory.
        ground: as `recon.fit` takes it.
        between: as `recon.fit` takes it.
        robust: as `recon.fit` takes it.

    Raises:
        ReconError, FileNotFoundError: as `recon.fit`.
    """
    cutoff = None if robust == "auto" else finite_number(robust, "robust")
    paths, geometries = paths_given(given), geometries_given(given)
    if paths or geometries:
        plane = None if isinstance(ground, str) else ground
        how = replace(FitSettings(**vars(how_read)), robust=cutoff, ground=plane, between=between)
        # each of the two readers, one of files and one of arrays, is imported only when needed
        if paths:
            from recon.reading.clip import load_clip as read
        else:
            from recon.reading.geometries import load_geometries as read
        given = read(paths or geometries, how, body)
        if given.ground_given:
            ground = "auto"  # the reader already applied the given ground
    elif names := how_read.changed_names():
        raise ReconError(
            f"{', '.join(names)}: options for reading files, but the observations are not files; "
            "leave them out"
        )
    clip = clip_of(given, body)
    if not any(len(seen_times(one)) for one in clip.observations):
        raise ObservationError(
            f"{', '.join(clip.names)}: expected at least one point that is seen, got none; points "
            "are seen where masks are True and confidences above 0"
        )
    if between is not None:
        clip = clip_between(clip, *between)
    if cutoff is not None:
        clip = with_robust_kernel(clip, cutoff)
    return in_fit_frame(clip, ground)


def fit_and_check(
    observations: Sequence[Sensor],
    names: Sequence[str],
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
    start: Motion | None = None,
    checks: Sequence[Check] | None = None,
) -> ExaminedClip:
    """Fit one clip: check the observations, fit, check the result.

    Args:
        observations: sensors of one clip that share a frame; a batch axis of length one.
        names: of the sensors, for messages.
        options: how to fit; `repair` says whether faults are put right.
        body: whose motion it is.
        watch: told about every iteration.
        start: a first guess in the frame of the observations, axes (1, time).
        checks: of the data and of the fit; None are all, an empty tuple is none.

    Raises:
        ValueError: when observations contradict each other, or the start or the prior does not
            fit them; says what to do.
    """
    if len(views_of(observations)) > 1:  # imported only for several views
        from observations.common_clock import on_common_clock

        observations = on_common_clock(observations)
    clip = CheckedClip(
        observations=tuple(observations), names=tuple(names), options=options, body=body
    )
    if is_preview(options.method):  # imported only when a preview is asked for
        from recon.api.preview import preview

        return preview(clip, start, checks)
    if options.completes and start is not None:
        raise ValueError("a gait cycle is fitted from many starts: leave `start` out")
    if checks is None:
        # imported only when the default checks are used
        from recon.diagnosis.checks import AFTER, BEFORE

        checks = (*BEFORE, *AFTER)
    of_data = [one for one in checks if getattr(one, "comes_before_fit", False)]
    of_fit = [one for one in checks if one not in of_data]
    # check the data: repair faults that are certain, warn of the others
    clip = checked(clip, of_data if options.repair else ())
    # data with more frames per second than movements need are averaged to a lower rate
    fewer = clip.observations if options.completes else [paced(one) for one in clip.observations]
    found = clip.start if start is None else None
    start = _start_at_data_rate(fewer, start, found)
    if clip.belt is not None and start is not None:
        from recon.diagnosis.movement import motion_in_room  # imported only for treadmills

        start = motion_in_room(start, -clip.belt)
    if options.completes:
        fit = _completed_recording(fewer, options, body, watch, start)
    else:
        # first guess: a motion made from the data without a prior, or the one that the caller gave
        seen, guess = with_first_guess(fewer, body, start, options.starting_shape)
        guess = replace(guess, posed=found is not None)
        # the problem to solve: residuals over their noise, with ground and focal length if unknown
        # and its solution: minima of the prior's stages, one after the other
        fit = clip_problem(seen, guess, options, body, watch).solved()
    # check the result: residuals, standard deviations, other hypotheses, plausible movement
    return checked(ExaminedClip.of(clip, fit), of_fit)


def _start_at_data_rate(
    seen: Sequence[Sensor], start: Motion | None, guess: Motion | None
) -> Motion | None:
    """Return the initial motion (the caller's, else the checks') at the data's frame rate.

    A caller's motion with a lower frame rate than the data keeps its own.
    """
    if start is not None:
        return start.resample(min(start.fps, max(one.fps for one in seen)))
    return guess and guess.resample(max(one.fps for one in seen if one.named))


def _completed_recording(
    observations: Sequence[Sensor], options: FitOptions, body: BodyModel, watch: Watch | None,
    start: Motion | None,
) -> ClipFit:  # fmt: skip
    """Complete one gait cycle, or a whole sparse recording, whichever the prior is for."""
    # imported only when a gait cycle or a sparse recording is completed
    from recon.fitting.cycles import complete
    from recon.fitting.recording import WholeRecording, complete_recording

    prior = loaded_prior(options.prior, options.weights, body)
    if isinstance(prior, WholeRecording):
        return complete_recording(observations, prior, options, body, watch, start)
    return complete(observations, replace(options, prior=prior), body, watch)
