"""Finds a camera view that contradicts the others, the likeliest cause, and a correction.

Points that the other views triangulate are compared with the rays of the view. An explanation that
reduces their distance to the noise of the keypoints is certain, and its correction is applied. A
view without such an explanation is left out where the others agree, else it gets a warning.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from recon.diagnosis.explanations import Cause, DoubtedView, ExplainedView, mirrored
from recon.diagnosis.findings import (
    NOTHING,
    Code,
    Finding,
    Findings,
    long_runs,
    run_checks,
    spans,
    stretches,
)
from recon.diagnosis.images import Images
from recon.diagnosis.rigs import TwoViewCorrection, best_agreement, ray_distance, repaired_rig

_MISS_STDS = 2.2
"""Largest distance, in standard deviations of the keypoints, between the rays of a good view and
the points of two others; validation windows have 1.4 to 2.1."""
_PAIR_MISS_STDS = 0.8
"""Largest distance, in standard deviations of the keypoints, between the rays of two good views
and the points triangulated from both; validation windows have 0.5."""
_ALL_MISS_STDS = 1.2
"""Largest distance, in standard deviations of the keypoints, between the rays of three or more
good views and the points triangulated from all; validation windows have 0.8."""
_SUSPECT_RATIO = 1.3
"""Ratio of a view's distance to that of good views, from which on the view is examined."""
_MIN_ODDS_M = 0.095
"""Distance (m) from which on a view is called at odds whatever its noise: real recordings with a
usable calibration (Pose2Sim's) stay below 0.087."""
_MIN_PAIR_ODDS_M = 0.06
"""Distance (m) between the rays of two views and their common points, from which on they are
called at odds; usable calibrations stay below 0.032."""
_STRETCH_MISS_M = 0.2
"""Distance (m) by which a view must miss the others for a stretch to be left out."""
_MIN_STRETCH_S = 0.15
"""Least duration (s) of a stretch that is left out."""
_SIMPLER_RATIO = 1.15
"""Ratio to the least remaining error up to which the simplest explanation is preferred."""
_MAX_MIRRORED_RATIO = 0.6
"""Ratio to which mirroring or another correction must reduce the error."""


def noise_of_views(images: Images) -> float:
    """Return the standard deviation of keypoints (m at the body), as the median over views."""
    own = (images.noise / np.median(images.scale, -1))[images.seen.any((1, 2))]
    return float(np.median(own)) if own.size and np.isfinite(own).all() else 0.0


def checked_against_each_other(images: Images) -> tuple[Images, Findings]:
    """Find views that contradict the others, are shifted in time, or are mirrored."""
    if len(images.names) < 2:
        return images, NOTHING
    noise = noise_of_views(images)
    if len(images.names) == 2:
        return _two_views_corrected(images, noise)
    explained = partial(_one_view_corrected, noise=noise, causes=tuple(_CAUSES))
    return run_checks(
        images, (repaired_rig, explained, partial(_without_contradicting_view, noise=noise))
    )


def mirroring_repaired(images: Images) -> tuple[Images, Findings]:
    """Mirror all images if they agree only when mirrored, as a front camera writes them."""
    mirrored_images, said, sure = mirrored_together(images)
    if said is None:
        return images, NOTHING
    if sure:
        done = "they were mirrored back. Give the videos as they were filmed"
        return mirrored_images, Findings((replace(said, message=f"{said.message}; {done}"),))
    return images, Findings(warnings=mirror_warnings(images))


def mirror_warnings(images: Images) -> tuple[Finding, ...]:
    """Return warnings about images that agree better when mirrored but were not changed."""
    said = mirrored_together(images)[1]
    todo = "mirror the videos back before keypoints are detected"
    return () if said is None else (replace(said, message=f"{said.message}; {todo}"),)


def mirrored_together(images: Images) -> tuple[Images, Finding | None, bool]:
    """Mirror all images; also return a finding if they agree better, and if within their noise.

    One view is not enough, as it shows what the mirrored person would have done.
    """
    usual = noise_of_views(images) * (
        _PAIR_MISS_STDS if len(images.names) == 2 else _ALL_MISS_STDS
    )
    flipped = mirrored(images, list(range(len(images.names))))
    given, other = ray_distance(images), ray_distance(flipped)
    if given < max(usual, 0.002) or other > _MAX_MIRRORED_RATIO * given:
        return flipped, None, False
    said = (
        f"the images seem to be mirrored: their rays miss each other by {100 * given:.1f} cm, and "
        f"by {100 * other:.1f} cm when left and right of all images are exchanged"
    )
    return flipped, Finding("mirrored", said, value=given), other <= usual


def mirrored_or_scaled_view_corrected(images: Images) -> tuple[Images, Findings]:
    """Correct a view that agrees with the others only when mirrored or scaled.

    This precedes the checks of names, as wrong pixels make names look wrong.
    """
    if len(images.names) < 3:
        return images, NOTHING
    return _one_view_corrected(images, noise_of_views(images), ("mirrored", "sized"))


def _one_view_corrected(
    images: Images, noise: float, causes: tuple[Cause, ...]
) -> tuple[Images, Findings]:
    """Correct the one view after whose correction all views agree within the noise."""
    usual, best = _MISS_STDS * noise, np.inf
    out, said = images, NOTHING
    for v, name in enumerate(images.names):
        doubted = DoubtedView.of(images, v)
        before = doubted.median_ray_distance()
        if before < _SUSPECT_RATIO * usual or usual == 0:
            continue
        rest = ray_distance(images.view([k for k in range(len(images.names)) if k != v]))
        chosen = _simplest_explanation(doubted.corrected_by_cause(causes))
        if max(rest, chosen.remains) <= usual and rest + chosen.remains < best:
            code, what, _ = _CAUSES[chosen.cause]
            text = (
                f"{name} contradicts the other views by {100 * before:.1f} cm, and by "
                f"{100 * chosen.remains:.1f} cm if {what.format(chosen.value)}"
            )
            best, out = rest + chosen.remains, chosen.images
            said = Findings((Finding(code, text, value=chosen.value or before),))
    return out, said


def _simplest_explanation(options: list[ExplainedView]) -> ExplainedView:
    least = min(option.remains for option in options)
    return next(option for option in options if option.remains <= _SIMPLER_RATIO * least)


_OTHER_PERSON = (
    "Likeliest it shows another person, or the files and cameras of two views are mixed up; check "
    "who is followed (--person) and which calibration belongs to which view"
)
_CAUSES: dict[Cause, tuple[Code, str, str]] = {
    "mirrored": (
        "mirrored",
        "its images are mirrored; they were mirrored back",
        "Its images seem to be mirrored; mirror them back before keypoints are detected",
    ),
    "sized": (
        "view at odds",
        "its keypoints are {:.2f} times as large as its calibration's image; they were scaled. "
        "Give keypoints and calibration of one resolution",
        "Its keypoints seem to be of another image size; give those of the calibration's",
    ),
    "turned": (
        "view at odds",
        "its camera is turned by {:.1f} degrees against the calibration; the pose was corrected. "
        "Calibrate anew",
        "Its camera seems to be turned; calibrate anew",
    ),
    "placed": (
        "view at odds",
        "its camera stands {:.2f} m from where the calibration has it; the pose was corrected. "
        "Calibrate anew",
        _OTHER_PERSON,
    ),
    "moving": (
        "camera moves",
        "its camera, declared fixed, turns by {:.1f} degrees during the clip; its poses were "
        "estimated. Fix the camera, or give a pose for every frame",
        _OTHER_PERSON,
    ),
}
"""What may be wrong with a view, the simplest first: code, description of the repair, advice."""


def _without_contradicting_view(images: Images, noise: float) -> tuple[Images, Findings]:
    """Leave out a contradicting view (or stretches of it) if the others agree, else warn."""
    views = range(len(images.names))
    rest = [ray_distance(images.view([k for k in views if k != v])) for v in views]
    v = int(np.argmin(rest))
    doubted, name = DoubtedView.of(images, v), images.names[v]
    before, agree = doubted.median_ray_distance(), 0 < rest[v] <= _MISS_STDS * noise
    hidden = np.zeros_like(images.seen)
    if before > _MIN_ODDS_M:
        hidden[v], frames, size = True, (), before
        least = _simplest_explanation(doubted.corrected_by_cause(tuple(_CAUSES)))
        clear = least.remains < _MAX_MIRRORED_RATIO * before
        hint = _CAUSES[least.cause][2] if clear else _OTHER_PERSON
        said = f"{name} contradicts the other views: its rays miss their points by {size:.2f} m"
        left_out = f"{said}, while they agree with each other; it was left out. {hint}"
        warned = f"{said}. {hint}"
    else:
        miss = doubted.ray_distances()
        away = np.array([np.median(row[known]) if known.any() else 0.0
                         for row, known in zip(miss, np.isfinite(miss), strict=True)])  # fmt: skip
        hidden[v] = long_runs(away > _STRETCH_MISS_M, round(_MIN_STRETCH_S * images.fps))[:, None]
        if not hidden.any():
            return images, NOTHING
        frames = stretches(hidden[v, :, 0])
        size = float(np.median(away[hidden[v, :, 0]]))
        said = (
            f"{name} contradicts the other views by {size:.2f} m in {spans(frames)}, as when it "
            "follows another person there"
        )
        left_out = f"{said}; these frames of it were left out"
        warned = f"{said}; check who is followed"
    found = Finding("view at odds", left_out if agree else warned, frames=frames, value=size)
    if agree:
        return images.without(hidden), Findings((found,))
    return images, Findings(warnings=(found,))


def _two_views_corrected(images: Images, noise: float) -> tuple[Images, Findings]:
    """Check two views for contradictions: clocks can be corrected, poses are only reported."""
    given, usual = ray_distance(images), _PAIR_MISS_STDS * noise
    if given <= max(_SUSPECT_RATIO * usual, 0.002):
        return images, NOTHING
    names = " and ".join(images.names)
    said = f"{names} contradict each other: their rays miss by {100 * given:.1f} cm"
    timed = best_agreement(images, ("clock",))
    by, clear = _clock_shift_in_words(images, timed), timed.remains < _MAX_MIRRORED_RATIO * given
    if clear and timed.remains <= usual:
        text = (
            f"{said}, and by {100 * timed.remains:.1f} cm if {by}; its keypoints were moved in "
            "time. Number the frames of all cameras from the same moment"
        )
        late, sensors = timed.late / images.fps, images.names[1:]
        done = Finding("views out of step", text, value=late, sensors=sensors)
        return timed.images, Findings((done,))
    turned, both = best_agreement(images, ("pose",)), best_agreement(images, ("clock", "pose"))
    if both.remains < turned.remains / _SIMPLER_RATIO:
        turned = both
    code: Code = "view at odds"
    if turned.remains <= usual and turned.remains < _MAX_MIRRORED_RATIO * given:
        late = f"{_clock_shift_in_words(images, turned)} and " if turned.late else ""
        text = (
            f"{said}, and by {100 * turned.remains:.1f} cm if {late}one of the cameras is turned "
            f"by {turned.degrees:.1f} degrees against the calibration. Two views do not tell "
            "which of them, so nothing was changed. Calibrate anew, see that the frames of both "
            "are numbered from the same moment, or add a view"
        )
    elif given <= _MIN_PAIR_ODDS_M:
        return images, NOTHING
    elif clear:
        code, text = "views out of step", f"{said}; it seems that {by}"
    else:
        text = (
            f"{said}. Check that each has its own camera's calibration, in the image size of its "
            "keypoints, and that both show the same person at the same time"
        )
    return images, Findings(warnings=(Finding(code, text, value=given),))


def _clock_shift_in_words(images: Images, found: TwoViewCorrection) -> str:
    late = found.late / images.fps
    return f"{images.names[1]} is {1000 * abs(late):.0f} ms {'late' if late > 0 else 'early'}"
