"""The first guess of a fit: from all observations of a clip together, or the caller's motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.method.reconstruction import checked_start
from recon.method.sensor import Sensor, views_of


@dataclass(frozen=True)
class FirstGuess:
    """The motion that the fit starts from, and what is known about it."""

    motion: Motion
    distance_known: bool
    """Whether the body's position is known; one camera tells only its direction.

    Stage 1 of a fit places the rest body better. Where only a direction is known the stage is left
    out, as it would explain bent limbs by a larger distance.
    """
    aligned: bool = False  # whether trunk and limbs point where the data show them
    posed: bool = False
    """Whether the motion was already fitted, so that placing it again would make it worse."""


def first_guess(observations: Sequence[Sensor], body: BodyModel) -> FirstGuess:
    """Make a first motion from the most informative of a clip's observations.

    Points that are known by name come first, then what several cameras see, then what one camera
    sees, at the distance and in the posture of the depth where there is depth, and depth alone
    last. Where there is none of these, the first sensor's own guess is taken.
    """
    named = [named for one in observations if (named := one.named)]
    views = views_of(observations)
    clouds = [cloud for one in observations if (cloud := one.cloud)]
    if not named and not views and not clouds:
        return FirstGuess(observations[0].start(body), True)
    if named:
        return FirstGuess(named[0].start(body), True, aligned=True)
    if len(views) > 1:
        # imported only when several cameras see the points, which may be triangulated then
        from observations.camera_paths import guess_from_views, views_to_triangulate

        if alike := views_to_triangulate(views):
            return FirstGuess(guess_from_views(body, alike), True, aligned=True)
    if clouds:
        posed = clouds[0].start(body)
        return FirstGuess(_copy_poses(posed, views[0].start(body)) if views else posed, True)
    return FirstGuess(views[0].start(body), False)


def _copy_poses(posed: Motion, placed: Motion) -> Motion:
    """Give motion `placed` the poses and translations of `posed`, at the frame rate of `placed`.

    The rest pose stretches its arms out. In front of a cloud they would stay in front of it: no
    point is near them, so none pulls them back. Before the other motion begins and after it has
    ended, the path of the first one goes on.
    """
    times = placed.start_time + torch.arange(placed.frames, dtype=torch.float64) / placed.fps
    begin, end = (
        min(max(time, placed.start_time), placed.stop_time)
        for time in (posed.start_time, posed.stop_time)
    )
    shared = times.clamp(begin, end).to(placed.translation.device)
    sampled = posed.at(shared.clamp(max=posed.stop_time), placed.fps)
    shift = sampled.translation - placed.at(shared, placed.fps).translation
    return placed.replace(translation=placed.translation + shift, rotations=sampled.rotations)


def with_labelled_clouds(observations: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """Add body-part labels to all clouds, unless a sensor has named points.

    Named points determine the posture better than labels.
    """
    if any(one.named for one in observations):
        return tuple(observations)
    return tuple(one.cloud.labelled() if one.cloud else one for one in observations)


def with_first_guess(
    observations: Sequence[Sensor],
    body: BodyModel,
    start: Motion | None,
    shape: Float[Tensor, " shape"] | None,
) -> tuple[tuple[Sensor, ...], FirstGuess]:
    """Return the observations (clouds labelled if needed) and the motion a fit starts from.

    Args:
        observations: of one clip.
        body: the body model.
        start: the caller's motion; None makes one of the data, without a prior.
        shape: coefficients that the motion gets, where they are known.

    Raises:
        ObservationError: when only some observations say that their z = 0 is the ground.
        ReconError: when `start` does not fit the observations or the body.
    """
    if len({one.ground_known for one in observations}) > 1:
        said = ", ".join(f"{one.kind} {one.ground_known}" for one in observations)
        raise ObservationError(
            "all observations are in one coordinate frame, but only some say that z = 0 is the "
            f"ground (ground_known: {said}). Make ground_known the same in all, or give recon.fit "
            "ground='known' or 'unknown'; a camera states it by its pose, T_camera_world"
        )
    if start is None:
        seen = with_labelled_clouds(observations)
        guess = first_guess(seen, body)
    else:
        seen = tuple(observations)
        guess = FirstGuess(checked_start(start, seen, body), True)
    if len(seen) > 1:  # imported only for several sensors
        from observations.common_clock import over_all_data

        guess = replace(guess, motion=over_all_data(guess.motion, seen, body))
    if shape is None:
        return seen, guess
    known = shape.to(guess.motion.shape).expand_as(guess.motion.shape)
    return seen, replace(guess, motion=guess.motion.replace(shape=known))
