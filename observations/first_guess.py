"""The first guess of a fit, from all observations of a clip together."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.method.sensor import Sensor, views_of

if TYPE_CHECKING:
    from observations.depth import PointCloud
    from observations.keypoints2d import Keypoints2D
else:
    Keypoints2D = PointCloud = Sensor  # the code of a sensor is loaded with its data

_OTHER_HEADINGS = (math.pi / 2, math.pi, 3 * math.pi / 2)


@dataclass(frozen=True)
class FirstGuess:
    """A motion to begin with."""

    motion: Motion
    distance_known: bool
    """Whether it is told where the body is, or only, by one camera, in which direction.

    Placing the rest body better, stage 1, helps the first and spoils the second: it would trade
    stretched limbs against distance.
    """
    others: tuple[Motion, ...] = ()
    """What it may be as well; only a fit can tell."""


def first_guess(observations: Sequence[Sensor], body: BodyModel) -> FirstGuess:
    """The rest body placed by the observations that tell most.

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
        return FirstGuess(named[0].start(body), True)
    if len(alike := one_clock(views)) > 1:
        # rays meet where several cameras saw the person
        from observations.camera_paths import tell_distance, views_start

        if tell_distance(alike):
            return FirstGuess(views_start(body, alike), True)
    if views and clouds:
        placed, posed = views[0].start(body), clouds[0].start(body)
        if clouds[0].labels is not None:  # headings were compared already
            return FirstGuess(_moved_like(posed, placed), True)
        stretched = _at_cloud(placed, clouds[0], body)
        moved = _moved_like(posed, stretched)
        root, others = stretched.rotations[..., :1, :, :], moved.rotations[..., 1:, :, :]
        moved = moved.replace(rotations=torch.cat((root, others), -3))
        return FirstGuess(moved, True, (stretched,))
    if clouds:
        motion = clouds[0].start(body)
        if clouds[0].labels is not None:  # headings were compared already
            return FirstGuess(motion, True)
        return FirstGuess(motion, True, tuple(_turned(motion, angle) for angle in _OTHER_HEADINGS))
    return FirstGuess(views[0].start(body), False)


def _turned(motion: Motion, angle: float) -> Motion:
    """The body in the same place with another heading, as points do not tell headings well."""
    about = so3.about_z(motion.translation.new_tensor(angle))
    root = about @ motion.rotations[..., :1, :, :]
    return motion.replace(rotations=torch.cat((root, motion.rotations[..., 1:, :, :]), -3))


def one_clock(views: Sequence[Keypoints2D]) -> list[Keypoints2D]:
    """The views that see the moments of the first."""

    def clock(view: Keypoints2D) -> tuple[object, ...]:
        return (view.fps, view.start_time, *view.pixels.shape[:-1])

    return [view for view in views if clock(view) == clock(views[0])]


def _at_cloud(motion: Motion, cloud: PointCloud, body: BodyModel) -> Motion:
    """The motion moved, frame by frame, so that its pelvis is in the middle of the points.

    The middle of the points is on the near side of the body, a few centimetres before the pelvis.
    """
    points = cloud.points.where(cloud.present[..., None], torch.nan)
    middle = points.nanmedian(-2).values
    pelvis = body.pose(motion).joints[..., :1, :]
    there, seen = cloud.at_own_times(pelvis, motion)
    away = middle[..., seen, :] - there[..., 0, :]
    return motion.replace(translation=motion.translation + _typical(away))


def _moved_like(posed: Motion, placed: Motion) -> Motion:
    """A motion in the postures and at the places of another one, which may be on another clock.

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
    there = posed.at(shared.clamp(max=posed.stop_time), placed.fps)
    away = there.translation - placed.at(shared, placed.fps).translation
    return placed.replace(translation=placed.translation + away, rotations=there.rotations)


def _typical(away: Float[Tensor, "batch seen 3"]) -> Float[Tensor, "batch 1 3"]:
    """The median over the moments that have points; zero without any."""
    return away.nanmedian(-2, keepdim=True).values.nan_to_num(0.0)


def labelled(observations: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """The observations with labels for their clouds, unless other points in space have names.

    Those tell the posture better than labels do.
    """
    if any(one.named for one in observations):
        return tuple(observations)
    return tuple(with_labels(one.cloud) if one.cloud else one for one in observations)


def with_labels(cloud: PointCloud) -> PointCloud:
    """The cloud with what the bundled network believes of its points, unless it has labels."""
    if cloud.labels is not None:
        return cloud
    eyes = cloud.eye(range(cloud.moments))
    level = cloud.ground_known or cloud.ground_seen
    found = _labeller()(cloud.points, cloud.present, cloud.fps, eyes, level=level)
    return cloud.derived(labels=found.to(dtype=cloud.points.dtype))


@cache
def _labeller() -> Callable[..., Any]:
    """The bundled network, loaded once, and with the first cloud."""
    from priors.labels.looking import CloudLabeller

    return CloudLabeller.load()
