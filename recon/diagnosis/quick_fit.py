"""Quick fits under the pose prior, for checks that compare points with a body."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float

from observations.noise import estimate_noise
from observations.points import TrackedPoints
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.core.arrays import finite_median
from recon.core.motion import Motion
from recon.core.residuals import geman_mcclure, squared
from recon.core.struct import concatenate
from recon.diagnosis.named_points import NamedPoints
from recon.method.pace import paced
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.reconstruction import solve
from recon.method.sensor import Sensor
from recon.method.stages import Stage, Stages
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS

S = TypeVar("S", bound=Sensor)

_BODY_RADIUS_M = 1.4
"""Distance (m) from a body's median point within which all of its points lie, arms stretched."""
_MAX_SPIKE_M = 0.5
"""Distance (m) by which a point may be away from its own median over a quarter of a second; hands
that punch and feet that kick turn around within less."""
_HALF_WINDOW_S = 0.12
"""Time (s) before and after each frame over which the running median is taken."""
_MAX_HALF_FRAMES = 7
"""Largest number of frames before and after in the running median, spread over that time."""


def without_implausible(points: NamedPoints) -> NamedPoints:
    """Mark points as unseen that are far from all others or jump away from their path."""
    away = np.linalg.norm(points.positions - _running_median(points), axis=-1)
    return points.without(_far_from_others(points) | (np.nan_to_num(away) > _MAX_SPIKE_M))


def _far_from_others(points: NamedPoints) -> Bool[np.ndarray, "moments points"]:
    away = np.linalg.norm(points.positions - points.centre[:, None], axis=-1)
    return np.nan_to_num(away) > _BODY_RADIUS_M


def smoothed(points: NamedPoints) -> NamedPoints:
    """Return running medians of the points over a quarter of a second, robust to outliers.

    They have no standard deviations, as medians also exist where points were not seen.
    """
    median = _running_median(points.without(_far_from_others(points)))
    known = np.isfinite(median[..., 0])
    places = np.where(known[..., None], median, 0.0)
    return replace(points, positions=places, visible=known, std=None)


def _running_median(points: NamedPoints) -> Float[np.ndarray, "moments points 3"]:
    """Return the median of every coordinate in a window about each frame; NaN if unseen."""
    frame_step = max(int(_HALF_WINDOW_S * points.fps) // _MAX_HALF_FRAMES, 1)
    half = max(int(_HALF_WINDOW_S * points.fps) // frame_step, 1) * frame_step
    shown = np.where(points.visible[..., None], points.positions, np.nan)
    padded = np.pad(shown, ((half, half), (0, 0), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    return finite_median(windows[..., ::frame_step])


ROBUST_SCALE = 0.15
"""Distance (m) beyond which a point counts ever less: several times the error of the pose prior at
good points, and less than the distance of two points that are confused."""
_EXCERPT_S = 6.0
"""Length (s) of the part of a recording that is enough to decide which version is a body."""
_MAX_NOISE_COST = 0.95
"""Ratio of the cost to ½ · 3 · noise², the cost of noise alone, up to which a version is taken to
be right. Right versions reach 0.34 to 1.13, those with sides exchanged 1.0 and more (validation
people)."""
QUICK_PACE = 20.0
"""Frame rate (Hz) of quick fits. At 15 Hz limbs follow names that are exchanged for 0.2 s."""
_SHAPE_WEIGHT = 1e-4
"""Weight of the shape prior: unlike in a fit, an odd body must not explain a misplaced point."""
_ITERATIONS, _ITERATIONS_OF_OTHERS = 40, 12
"""Largest numbers of iterations for the version as given and for other ones: a right version is
found within 5, and a wrong one goes on for long."""


@dataclass(frozen=True)
class QuickFit:
    """A quick fit to one version of a clip's points, with its objective."""

    points: TrackedPoints
    estimate: Estimate
    """Motion and scene of the fit, for one clip."""
    cost: float
    """Objective per visible point as at 30 Hz (m²); of an excerpt if the recording is long."""


def quick_fits(versions: Sequence[TrackedPoints], body: BodyModel) -> list[QuickFit]:
    """Fit versions of one clip's points with robust residuals under the pose prior.

    Costs may be compared, as all versions see the same frames. If the first one fits as well as
    its noise allows, no other can be clearly better, and only it is fitted. Of a long recording
    only the version of the least cost is fitted in full, and only that fit is returned.
    """
    given, versions = versions, [paced(one, QUICK_PACE) for one in versions]
    first = versions[0]
    noise = estimate_noise(first.positions, first.visible)
    method, excerpts = partial(quick_stages, noise), [middle_seconds(one) for one in versions]
    fits = _fits_of_versions(excerpts[:1], method, body)
    if len(versions) > 1 and fits[0].cost > _MAX_NOISE_COST * 1.5 * noise**2:
        fits += _fits_of_versions(
            excerpts[1:], partial(quick_stages, noise, max_iterations=_ITERATIONS_OF_OTHERS), body
        )
    if excerpts[0] is first:
        return [replace(one, points=own) for one, own in zip(fits, given, strict=False)]
    best = min(range(len(fits)), key=lambda row: fits[row].cost)
    start = smoothed(NamedPoints.of(versions[best], body)).observation.start(body)
    # imported only when a recording is long
    from recon.fitting.long import fit_long

    motion = fit_long([_with_robust_kernel(versions[best])], method, body, start=start).motion
    estimate = Estimate.of_clip(motion[0].detach(), body)
    return [QuickFit(given[best], estimate, fits[best].cost)]


def _with_robust_kernel(points: TrackedPoints) -> TrackedPoints:
    return points.replace(kernel=partial(geman_mcclure, sigma=ROBUST_SCALE))


def _fits_of_versions(
    versions: Sequence[TrackedPoints], method: Stages, body: BodyModel, start: Motion | None = None
) -> list[QuickFit]:
    """Fit all versions at once, starting from the medians of their points or a given motion."""
    robust = _with_robust_kernel(concatenate(list(versions)))
    if start is None:
        smooth = [smoothed(NamedPoints.of(one, body)).observation for one in versions]
        start = concatenate([one.start(body) for one in smooth])
    result = solve([robust], method, body, start=start)
    counted = robust.visible.sum((-2, -1)).clamp(min=1) * (REFERENCE_FPS / robust.fps)
    value = result.reports[-1].solution.value / counted
    return [
        QuickFit(one, Estimate.of_clip(result.motion[row].detach(), body), float(value[row]))
        for row, one in enumerate(versions)
    ]


def with_second_start(fit: QuickFit, body: BodyModel) -> QuickFit:
    """Return the better of a quick fit and one that starts from a fit with squared residuals.

    A robust fit gives up on a limb that it starts too far from, so that its points look misplaced,
    such as the hands of a handspring. With squared residuals the limb follows its points as far as
    its bones let it, and a robust fit from there has the lower objective unless the points really
    are misplaced. Long recordings are returned unchanged: no limb is lost throughout them.
    """
    if middle_seconds(fit.points) is not fit.points:
        return fit
    points = paced(fit.points, QUICK_PACE)
    noise = estimate_noise(points.positions, points.visible)
    method, start = partial(quick_stages, noise), fit.estimate.motion
    reached = solve([points.replace(kernel=squared)], method, body, start=start).motion
    (again,) = _fits_of_versions([points], method, body, reached.detach())
    return replace(again, points=fit.points) if again.cost < fit.cost else fit


def quick_stages(
    noise: float, data: tuple[Term, ...], *, max_iterations: int = _ITERATIONS
) -> tuple[Stage[Any], ...]:
    """Return the pose prior's last stage with few iterations, for errors of about a centimetre."""
    prior = PosePrior.load(weights=replace(PoseWeights.for_noise(noise), shape=_SHAPE_WEIGHT))
    minimiser = LBFGS(max_iterations=max_iterations, tolerance_decrease=1e-3)
    return (replace(prior.stages(data)[-1], minimiser=minimiser),)


def middle_seconds(sensor: S) -> S:
    """Cut out a few seconds around the median time of a sensor's data."""
    length = round(_EXCERPT_S * sensor.fps) + 1
    if sensor.moments <= length:
        return sensor
    counts = sensor.shown[0].sum(-1).double().cumsum(0)
    middle = int((counts < counts[-1] / 2).sum())
    first = min(max(middle - length // 2, 0), sensor.moments - length)
    start = sensor.start_time + first / sensor.fps
    return sensor.derived(**sensor.fields_at(range(first, first + length)), start_time=start)
