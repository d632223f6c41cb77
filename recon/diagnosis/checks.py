"""All checks in the order of work: those of the data before a fit, then those of the fit.

A check is a function of the clip that gives the clip, put right where that is sure, and what it
found. `recon.fit(..., checks=...)` takes any of them, and functions of your own:

    def short(clip: Examined) -> tuple[Examined, Findings]:
        said = Finding("gap", "less than a second was seen")
        return clip, Findings(warnings=(said,) if clip.motion.frames < clip.motion.fps else ())
"""

from dataclasses import replace

from recon.diagnosis.agreement import residual_warnings
from recon.diagnosis.carried import treadmill_finding, with_belt
from recon.diagnosis.doubts import guessed_findings, undecided_findings, unseen_findings
from recon.diagnosis.examination import (
    AfterFit,
    BeforeFit,
    CheckedClip,
    Examined,
    after_fit,
    before_fit,
)
from recon.diagnosis.findings import NOTHING, Finding, Findings
from recon.diagnosis.frame_rate import rate_finding
from recon.diagnosis.movement import support_findings
from recon.diagnosis.plausibility import child_findings
from recon.diagnosis.points import screen_points


@before_fit("view")
def images(clip: CheckedClip) -> tuple[CheckedClip, Findings]:
    """Zeros, copies, outliers, exchanged names, and cameras that contradict each other."""
    from recon.diagnosis.keypoints import screen_views  # for clips with images alone

    views = {k: one.view for k, one in enumerate(clip.observations) if one.view}
    names = [clip.names[k] for k in views]
    checked, found = screen_views(list(views.values()), names, clip.body)
    kept = dict(enumerate(clip.observations)) | dict(zip(views, checked, strict=True))
    return replace(clip, observations=tuple(kept.values())), found


@before_fit("named")
def points(clip: CheckedClip) -> tuple[CheckedClip, Findings]:
    """Zeros, repeated values, exchanged and misplaced points, outliers, jumps, scale, ground."""
    kept, found, belt = list(clip.observations), NOTHING, None
    for row, one in enumerate(clip.observations):
        if one.named is None:
            continue
        grounded = clip.options.grounded
        kept[row], more, own = screen_points(one.named, clip.body, grounded=grounded)
        found += more.of(clip.names[row])
        belt = own if belt is None else belt
    return replace(clip, observations=tuple(kept), belt=belt), found


@before_fit("named")
def treadmill(clip: CheckedClip) -> tuple[CheckedClip, Findings]:
    """Points on a treadmill are carried along with its belt, unless a sensor stays in the room."""
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
    carried = tuple(with_belt(one, clip.belt) for one in tracked)
    return replace(clip, observations=carried), Findings((said,))


@after_fit("view")
def focal_length(clip: Examined) -> tuple[Examined, Findings]:
    """The focal length of the one camera that nobody calibrated, as it was found."""
    from recon.diagnosis.cameras import lens_doubtful, lens_finding

    said = () if (one := lens_finding(clip.names[0], clip.fit)) is None else (one,)
    if lens_doubtful(clip.fit):
        return clip, Findings(warnings=said)
    return clip, Findings(diagnosis=said)


@after_fit("view")
def camera_moves(clip: Examined) -> tuple[Examined, Findings]:
    """Whether a camera moved that alone has seen the clip, and that is declared fixed."""
    view = clip.observations[0].view
    if len(clip.observations) > 1 or view is None or not clip.fit.grounded:
        return clip, NOTHING
    if view.camera.T_camera_world.shape[-3] > 1:
        return clip, NOTHING
    from recon.diagnosis.cameras import moving_finding, rest_of
    from recon.diagnosis.carried import carried_finding
    from recon.diagnosis.images import Images

    seen = Images.of([view], clip.names, clip.model)
    rest = rest_of(seen)
    if rest is not None and rest.moves:
        return clip, Findings(warnings=(moving_finding(clip.names[0], seen, rest),))
    if _broken(clip):
        return clip, NOTHING
    rests = rest is not None and not rest.may_move
    said = carried_finding(clip.names[0], clip.motion, clip.model, clip.seen, rests=rests)
    return clip, Findings(warnings=() if said is None else (said,))


def _broken(clip: Examined) -> bool:
    """Whether the speed of the motion says nothing about its rate."""
    return any(one.code in ("identity change", "frame order") for one in clip.warnings)


@after_fit()
def residuals(clip: Examined) -> tuple[Examined, Findings]:
    """Sensors whose residuals are far above their noise: model and data contradict each other."""
    return clip, Findings(warnings=residual_warnings(clip.residuals))


@after_fit("view")
def distance(clip: Examined) -> tuple[Examined, Findings]:
    """A wrong focal length moves a body to where nobody films."""
    from recon.diagnosis.cameras import distance_warnings

    sensors = zip(clip.names, clip.observations, strict=True)
    return clip, Findings(warnings=tuple(
        warning
        for name, one in sensors
        if one.view
        for warning in distance_warnings(name, one.view, clip.estimate)
    ))  # fmt: skip


@after_fit("cloud")
def basin(clip: Examined) -> tuple[Examined, Findings]:
    """Whether a fit to clouds has locked on to a wrong posture or heading."""
    from recon.diagnosis.basins import basin_findings

    sensors = zip(clip.residuals, clip.observations, strict=True)
    return clip, Findings(warnings=tuple(
        warning
        for own, one in sensors
        if one.cloud
        for warning in basin_findings(own.name, one.cloud, own.quantiles, clip.estimate)
    ))  # fmt: skip


@after_fit()
def size_and_soles(clip: Examined) -> tuple[Examined, Findings]:
    """Nobody is as large or odd as the fitted person, or floats above a known ground."""
    return clip, Findings(warnings=clip.of_body)


@after_fit("view")
def mirrored(clip: Examined) -> tuple[Examined, Findings]:
    """Images that fit together better when mirrored."""
    from recon.diagnosis.cameras import mirror_warnings

    return clip, Findings(
        warnings=mirror_warnings([one.view for one in clip.observations if one.view])
    )


@after_fit()
def frame_rate(clip: Examined) -> tuple[Examined, Findings]:
    """Gait, falls and balance that contradict the frame rate."""
    # cameras whose ground and person do not fit together measure in no metres
    in_metres = not any(one.view for one in clip.observations) or all(
        one.code != "floor" for one in clip.of_body
    )
    if not clip.fit.grounded or _broken(clip) or not in_metres:
        return clip, NOTHING
    said = rate_finding(clip.motion, clip.model, clip.seen)
    return clip, Findings(warnings=() if said is None else (said,))


@after_fit()
def other_motions(clip: Examined) -> tuple[Examined, Findings]:
    """Another motion that explains the data nearly as well."""
    return clip, Findings(warnings=undecided_findings(clip.alternatives))


@after_fit()
def unseen(clip: Examined) -> tuple[Examined, Findings]:
    """Joints and frames that nothing was seen of."""
    return clip, Findings(diagnosis=unseen_findings(clip.observed))


@after_fit()
def guessed(clip: Examined) -> tuple[Examined, Findings]:
    """Stretches in which a large part of the body is merely guessed."""
    if clip.deviations is None:
        return clip, NOTHING
    std = clip.deviations.joints.numpy()
    return clip, Findings(diagnosis=guessed_findings(std, clip.observed, clip.motion.fps))


@after_fit()
def support(clip: Examined) -> tuple[Examined, Findings]:
    """Feet at several heights, and rests on something else than feet."""
    if not clip.fit.grounded:
        return clip, NOTHING
    return clip, Findings(diagnosis=support_findings(clip.motion, clip.model, clip.seen))


@after_fit()
def child(clip: Examined) -> tuple[Examined, Findings]:
    """Points in metres that a small body fits show a child, which is no fault of the data."""
    return clip, Findings(diagnosis=child_findings(clip.fit))


BEFORE: tuple[BeforeFit, ...] = (images, points, treadmill)
"""Checks of the data; what they repair is fitted as repaired."""
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
    child,
)
"""Checks of the fit."""
