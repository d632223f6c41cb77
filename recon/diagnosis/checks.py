"""All checks in the order in which they run: of the data before a fit, then of the fit.

A check is a function that takes a clip and returns it, repaired where a fault is certain, with
its findings. `recon.fit(..., checks=...)` takes any of them, and functions of your own:

    def short(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
        said = Finding("gap", "less than a second was seen")
        return clip, Findings(warnings=(said,) if clip.motion.frames < clip.motion.fps else ())
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.body.model import ODDEST
from recon.body.soles import ground_heights
from recon.core.limits import FEW_MOMENTS
from recon.core.skeleton import JOINTS
from recon.diagnosis.examination import (
    AfterFit,
    BeforeFit,
    CheckedClip,
    ExaminedClip,
    after_fit,
    before_fit,
)
from recon.diagnosis.findings import (
    NOTHING,
    Finding,
    Findings,
    flagged,
    listed,
    spans,
    stretches,
)
from recon.diagnosis.frame_rate import rate_finding
from recon.diagnosis.movement import (
    height_findings,
    in_belt_frame,
    support_findings,
    treadmill_finding,
)
from recon.diagnosis.points import screen_points
from recon.fitting.records import ClipFit
from recon.method.sensor import Sensor, views_of


@before_fit("view")
def images(clip: CheckedClip) -> tuple[CheckedClip, Findings]:
    """Check 2D keypoints for zeros, repeated frames, outliers, exchanged names, wrong cameras."""
    from recon.diagnosis.keypoints import screen_views  # imported only when a clip has images

    views = {k: one.view for k, one in enumerate(clip.observations) if one.view}
    names = [clip.names[k] for k in views]
    checked, found = screen_views(list(views.values()), names, clip.body)
    kept = dict(enumerate(clip.observations)) | dict(zip(views, checked, strict=True))
    return replace(clip, observations=tuple(kept.values())), found


@before_fit("named")
def points(clip: CheckedClip) -> tuple[CheckedClip, Findings]:
    """Check 3D points for zeros, repeats, wrong names, outliers, jumps, scale and ground."""
    kept, found, belt, start = list(clip.observations), NOTHING, None, None
    for row, one in enumerate(clip.observations):
        if one.named is None:
            continue
        grounded = clip.options.grounded
        kept[row], more, own, motion = screen_points(one.named, clip.body, grounded=grounded)
        found += more.of_sensor(clip.names[row])
        belt = own if belt is None else belt
        start = motion if start is None else start
    return replace(clip, observations=tuple(kept), belt=belt, start=start), found


@before_fit("named")
def treadmill(clip: CheckedClip) -> tuple[CheckedClip, Findings]:
    """Detect a treadmill and move points with its belt, unless a sensor is fixed to the room."""
    if clip.belt is None:
        return clip, NOTHING
    tracked = [one.named for one in clip.observations if one.named]
    speed = float(clip.belt.norm())
    if len(tracked) < len(clip.observations) or clip.options.completes:
        return replace(clip, belt=None), Findings(warnings=(treadmill_finding(clip.belt),))
    said = Finding(
        "treadmill",
        f"standing feet are all carried along at {speed:.2f} m/s, as on a treadmill: the motion "
        "was fitted in the frame of the belt and carried back to the room",
        value=speed,
    )
    carried = tuple(in_belt_frame(one, clip.belt) for one in tracked)
    return replace(clip, observations=carried), Findings((said,))


@after_fit("view")
def focal_length(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Report the fitted focal length of an uncalibrated camera."""
    from recon.diagnosis.cameras import lens_findings

    return clip, lens_findings(clip.names[0], clip.fit)


@after_fit("view")
def camera_moves(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn when the clip's only camera moved although it is declared fixed."""
    view = clip.observations[0].view
    if len(clip.observations) > 1 or view is None or not clip.fit.grounded:
        return clip, NOTHING
    if view.camera.T_camera_world.shape[-3] > 1 or view.fps < FEW_MOMENTS:
        return clip, NOTHING
    from recon.diagnosis.cameras import moving_finding, slowest_foot_speeds
    from recon.diagnosis.carried import turned_camera_finding
    from recon.diagnosis.images import Images

    seen = Images.of([view], clip.names, clip.body)
    rest = slowest_foot_speeds(seen)
    if rest is not None and rest.camera_moves:
        return clip, Findings(warnings=(moving_finding(clip.names[0], seen, rest),))
    if _rate_is_untestable(clip):
        return clip, NOTHING
    rests = rest is not None and not rest.camera_may_move
    said = turned_camera_finding(clip.names[0], clip.motion, clip.body, clip.seen, rests=rests)
    return clip, Findings(warnings=() if said is None else (said,))


def _rate_is_untestable(clip: ExaminedClip) -> bool:
    """Whether other faults, or too few frames per second, make speeds unfit for a judgement."""
    few = max(one.fps for one in clip.observations) < FEW_MOMENTS
    return few or any(one.code in ("identity change", "frame order") for one in clip.warnings)


_MAX_RESIDUAL_STDS = 5.0
"""Median residual, in estimated standard deviations, from which on it is suspicious."""
_MIN_SUSPICIOUS_RESIDUAL = {"pixels": 15.0, "metres": 0.06, "radians": 0.4}
"""Median residual below which nothing is suspicious, whatever the noise, by unit."""


def _likely_causes(observations: Sequence[Sensor]) -> str:
    """Describe likely causes of a wrong size or place of the body, by the kinds of sensors."""
    causes = {
        "focal lengths, image sizes, units and the poses of the cameras": any(
            one.view for one in observations
        ),
        "the scale (--unit), the axes (--up, --hand) and the labels of the points": any(
            one.named for one in observations
        ),
        "the scale (--unit) and the up axis (--up) of the clouds, and what else is in them": any(
            one.cloud for one in observations
        ),
    }
    return "; ".join(cause for cause, there in causes.items() if there) or "the scale of the data"


@after_fit()
def residuals(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn of sensors whose residuals are far above their noise."""
    found: list[Finding] = []
    for sensor, one in zip(clip.observations, clip.residuals, strict=True):
        if one.median is None:
            said = Finding("unseen", "nothing was seen at the times of the motion")
            found.append(said.of_sensor(one.name))
        elif one.median > max(_MAX_RESIDUAL_STDS * one.noise, _MIN_SUSPICIOUS_RESIDUAL[one.unit]):
            known = [(value, name) for name, value in one.by_point.items() if value is not None]
            points = tuple(name for _, name in sorted(known, reverse=True)[:3])
            where = f", most at {', '.join(points)}" if points else ""
            said = Finding(
                "residual",
                f"half of the data is more than {one.median:.3g} {one.unit} away from the fitted "
                f"body{where}, and the data's own noise is {one.noise:.2g}; what was recorded is "
                f"not what the file says: check which person it shows, {_likely_causes([sensor])}",
                points,
                value=one.median,
            )
            found.append(said.of_sensor(one.name))
    return clip, Findings(warnings=found)


@after_fit("view")
def distance(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn of an implausible distance of the person, which a wrong focal length causes."""
    from recon.diagnosis.cameras import distance_warnings

    sensors = zip(clip.names, clip.observations, strict=True)
    return clip, Findings(warnings=tuple(
        warning
        for name, one in sensors
        if one.view
        for warning in distance_warnings(name, one.view, clip.estimate)
    ))  # fmt: skip


@after_fit("cloud")
def basin(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn when a fit to clouds has converged to a wrong posture or heading."""
    from recon.diagnosis.basins import basin_findings

    sensors = zip(clip.residuals, clip.observations, strict=True)
    return clip, Findings(warnings=tuple(
        warning
        for own, one in sensors
        if one.cloud
        for warning in basin_findings(own.name, one.cloud, own.quantiles, clip.estimate)
    ))  # fmt: skip


@after_fit()
def size_and_soles(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn of an implausible size or shape of the fitted person, or feet off a known ground."""
    return clip, body_findings(clip.fit)


_MAX_SHAPE_STDS, _MAX_SHAPE_STDS_MARKERS = 1.5 * ODDEST, 15.0
"""Standard deviations of a shape coefficient that no person's fit exceeds. Noise and acrobatics
add to the differences between people, and real markers stand off the skin or away from the
landmark that they are named after: good recordings reach 14. Wrong units and scales show in the
height."""
_MAX_SOLE_HEIGHT_M = 0.15
"""Distance (m) of standing soles from a known ground, above which there is a warning."""


def body_findings(found: ClipFit) -> Findings:
    """Return warnings that the fitted body has an implausible size or stands off a known ground.

    Where no camera and no ground determines the size, the prior does, and nothing is reported.
    Points in metres that a small body fits show a child, which is no fault of the data.
    """
    posed, views = found.result.estimate.body, views_of(found.observations)
    tall = float(posed.model.height(posed.shape.detach()).mean())
    odd = float(posed.shape.abs().max())
    # shapes fitted to markers declared as on the skin vary more, since some stand off the skin
    on_skin = any(one.named and one.named.on_skin for one in found.observations)
    sizes = _likely_causes(found.observations)
    said = height_findings(tall, sizes, may_be_child=not views)
    if not said.warnings and odd > (_MAX_SHAPE_STDS_MARKERS if on_skin else _MAX_SHAPE_STDS):
        text = (
            f"the person's shape is {odd:.1f} standard deviations from the average; check {sizes}"
        )
        said += Findings(warnings=(Finding("body size", text, value=odd),))
    if found.ground_known:
        soles = float(ground_heights(found.result.motion, posed.model).median())
        if abs(soles) > _MAX_SOLE_HEIGHT_M:
            text = (
                f"the soles stand at {soles:.2f} m, but the ground is at 0; check {sizes}, unless "
                "the person stands or sits on something"
            )
            said += Findings(warnings=(Finding("floor", text, value=soles),))
    return said


@after_fit("view")
def mirrored(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn of images that agree better when mirrored, unless checks before the fit have."""
    from recon.diagnosis.keypoints import grouped_views
    from recon.diagnosis.odds import mirror_warnings

    if any(one.code == "mirrored" for one in clip.warnings):
        return clip, NOTHING
    names = [name for name, one in zip(clip.names, clip.observations, strict=True) if one.view]
    groups = grouped_views([one.view for one in clip.observations if one.view], names, clip.body)
    found = [said for _, images in groups for said in mirror_warnings(images)]
    return clip, Findings(warnings=found)


@after_fit()
def frame_rate(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn of a frame rate that gait, falls or balance contradict."""
    # if feet are off calibrated cameras' ground, units are wrong, and falls tell no frame rate
    in_metres = not any(one.view for one in clip.observations) or all(
        one.code != "floor" for one in body_findings(clip.fit).warnings
    )
    if not clip.fit.grounded or _rate_is_untestable(clip) or not in_metres:
        return clip, NOTHING
    said = rate_finding(clip.motion, clip.body, clip.seen)
    return clip, Findings(warnings=() if said is None else (said,))


_CLOSE_ENERGY = 0.15
"""Share of the energy by which another motion may be worse and still be nearly as likely. On five
validation windows of depth alone, where all headings were chosen well, the next was worse by 29 %
at least."""
_OTHER_M = 0.15
"""Mean distance of joints (m) from which on another posture is reported: quick fits that compare
first guesses leave smaller differences, which the final fit removes."""


@after_fit()
def other_motions(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Warn of the likeliest rejected motion if it explains the data nearly as well as the fit."""
    close = [
        one
        for one in clip.alternatives
        if one.excess < _CLOSE_ENERGY and (one.kind != "posture" or one.distance > _OTHER_M)
    ]
    if not close:
        return clip, NOTHING
    more = f" and {len(close) - 1} more" if len(close) > 1 else ""
    said = Finding(
        "undecided",
        f"another motion explains the data nearly as well: {close[0]}{more}; look at both, "
        "or add a sensor that tells them apart (`alternatives` in the report)",
        value=close[0].excess,
    )
    return clip, Findings(warnings=(said,))


@after_fit()
def unseen(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Note joints that were never seen and frames without any data; warn of too few moments."""
    found, rare = list[Finding](), tuple[Finding, ...]()
    if (rate := max(one.fps for one in clip.observations)) < FEW_MOMENTS:
        said = (
            f"only {rate:.2g} moments a second were seen: steps and turns between them are "
            "guessed, and speeds and contacts were not checked and are not to be trusted; "
            f"give the whole recording, with {FEW_MOMENTS:g} moments a second or more"
        )
        rare = (Finding("few moments", said, value=rate),)
    if never := flagged(JOINTS, ~np.any(clip.observed, axis=0)):
        said = (
            f"{listed(never)} {'was' if len(never) == 1 else 'were'} never seen; the prior "
            "inferred them (`observed` in the motion file)"
        )
        found.append(Finding("unseen", said, never, value=len(never) / len(JOINTS)))
    empty = ~np.any(clip.observed, axis=1)
    if frames := stretches(empty, 1, clip.ratio):
        said = (
            f"nothing was seen in {empty.mean():.0%} of the frames ({spans(frames)}); the motion "
            "there is inferred"
        )
        found.append(Finding("gap", said, (), frames, float(empty.mean())))
    found += [Finding("proposed", said) for one in clip.fit.result.reports for said in one.remarks]
    return clip, Findings(warnings=rare, diagnosis=found)


_GUESSED_STD_M = 0.1
"""Standard deviation of a coordinate (m) from which on a joint is merely guessed."""
_LARGE_PART = 0.25
"""Share of the joints that counts as a large part of the body."""
_MIN_GUESSED_S = 0.2
"""Total time (s) of guessed frames that is reported."""


@after_fit()
def guessed(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Note stretches in which a large unobserved part of the body is very uncertain.

    Joints that were seen are left out: that one camera leaves their distance open is no guess.
    """
    if clip.deviations is None:
        return clip, NOTHING
    std = clip.deviations.joints.numpy()
    loose = (std > _GUESSED_STD_M) & ~clip.observed
    flags = loose.mean(1) >= _LARGE_PART
    if flags.sum() < _MIN_GUESSED_S * clip.motion.fps:
        return clip, NOTHING
    names = flagged(JOINTS, loose[flags].mean(0) > 0.5)
    typical, frames = float(np.median(std[flags][loose[flags]])), stretches(flags, 1, clip.ratio)
    said = (
        f"{listed(names) if names else 'much of the body'} may be anywhere within some "
        f"{200 * typical:.0f} cm in {flags.mean():.0%} of the frames ({spans(frames)}): "
        "nothing that was seen shows where (`joint_std` in the motion file)"
    )
    return clip, Findings(diagnosis=(Finding("guessed", said, names, frames, typical),))


@after_fit()
def support(clip: ExaminedClip) -> tuple[ExaminedClip, Findings]:
    """Note feet at several heights, and support by something other than feet."""
    if not clip.fit.grounded:
        return clip, NOTHING
    return clip, Findings(
        diagnosis=support_findings(clip.motion, clip.body, clip.seen, clip.ratio)
    )


BEFORE: tuple[BeforeFit, ...] = (images, points, treadmill)
"""Checks of the data before the fit; data that they repair are fitted as repaired."""
AFTER: tuple[AfterFit, ...] = (
    focal_length,
    camera_moves,
    residuals,
    distance,
    basin,
    size_and_soles,
    mirrored,
    frame_rate,
    other_motions,
    unseen,
    guessed,
    support,
)
"""Checks of the fitted motion."""
