"""The first guess of a fit: from the data without a prior, or the caller's motion."""

from collections.abc import Sequence
from dataclasses import replace

from observations.first_guess import FirstGuess, first_guess, labelled
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.fitting.methods import FitOptions
from recon.method.sensor import Sensor
from recon.method.start import checked_start


def guessed(
    observations: Sequence[Sensor], options: FitOptions, body: BodyModel, start: Motion | None
) -> tuple[tuple[Sensor, ...], FirstGuess]:
    """The observations, clouds with labels, and a first motion of the shape that is known.

    Arguments and errors as of `recon.fitting.clip.fit_clip`.
    """
    if len({one.ground_known for one in observations}) > 1:
        said = ", ".join(f"{one.kind} {one.ground_known}" for one in observations)
        raise ObservationError(
            "observations share one frame, and only some say that its z = 0 is the ground "
            f"(ground_known: {said}). Make ground_known the same in all, or give recon.fit "
            "ground='known' or 'unknown'; cameras know it by their pose, T_camera_world"
        )
    if start is None:
        seen = labelled(observations)
        guess = first_guess(seen, body)
    else:
        seen = tuple(observations)
        guess = FirstGuess(checked_start(start, seen, body), True)
    known = options.shape
    if known is None and options.shape_prior is not None:
        known = options.shape_prior.mean
    if known is None:
        return seen, guess
    shape = known.to(guess.motion.shape).expand_as(guess.motion.shape)
    return seen, replace(guess, motion=guess.motion.replace(shape=shape))
