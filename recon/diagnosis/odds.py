"""One view at odds with the others: which one, the likeliest cause, and what can be undone.

Points that the other views see are compared with the rays of the view. An explanation that
brings the view back to the noise of the keypoints is sure, and undone. What no explanation brings
back is left out where the other views agree, and warned of otherwise.
"""

from functools import partial

import numpy as np

from recon.diagnosis.explanations import Cause, Explained, Odd, mirrored
from recon.diagnosis.findings import (
    NOTHING,
    Code,
    Finding,
    Findings,
    in_turn,
    lasting,
    spans,
    stretches,
)
from recon.diagnosis.images import Images
from recon.diagnosis.rays import Rays
from recon.diagnosis.rigs import Agreement, agreement, common_miss, corrected_rig

_FLOOR = 2.2
"""Distance, in standard deviations of the keypoints, by which rays of a good view miss the points
of two others, at most; validation windows have 1.4 to 2.1."""
_PAIR_FLOOR = 0.8
"""Distance, in standard deviations of the keypoints, by which rays of two good views miss the
points triangulated from both; validation windows have 0.5."""
_ALL_FLOOR = 1.2
"""Distance, in standard deviations of the keypoints, by which rays of all of three or more good
views miss their points; validation windows have 0.8."""
_WORSE = 1.3
"""Multiple of that floor from which on a view is looked into."""
_AT_ODDS = 0.095
"""Metres from which on a view is called at odds whatever its noise: real recordings with a
usable calibration (Pose2Sim's) stay below 0.087."""
_PAIR_AT_ODDS = 0.06
"""Metres by which rays of two views miss their common points, from which on they are called at
odds; usable calibrations stay below 0.032."""
_AWAY = 0.2
"""Metres by which a view must miss the others for a stretch to be left out."""
_STRETCH = 0.15
"""Seconds that such a stretch lasts at least."""
_SIMPLER = 1.15
"""Multiple of the least remaining error within which the simplest explanation is preferred."""
_MAX_MIRRORED_RATIO = 0.6
"""Mirrored images must fit together with less than this share of the error."""


def noise_of_views(images: Images) -> float:
    """Standard deviation of keypoints at the body, metres: the median over the views."""
    own = (images.noise / np.median(images.scale, -1))[images.seen.any((1, 2))]
    return float(np.median(own)) if own.size and np.isfinite(own).all() else 0.0


def checked_together(images: Images) -> tuple[Images, Findings]:
    """Views of one moment compared: one at odds, one out of step, one mirrored."""
    if len(images.names) < 2:
        return images, NOTHING
    noise = noise_of_views(images)
    if len(images.names) == 2:
        return _two_views(images, noise)
    explained = partial(_one_explained, noise=noise, causes=tuple(_CODES))
    return in_turn(images, (corrected_rig, explained, partial(_one_left_out, noise=noise)))


def all_mirrored(images: Images) -> tuple[Images, Findings]:
    """Images that fit together only when mirrored, as front cameras of phones write them.

    One view alone cannot tell: it shows what the mirrored person would have done.
    """
    if len(images.names) < 2:
        return images, NOTHING
    noise = noise_of_views(images)
    floor = (_PAIR_FLOOR if len(images.names) == 2 else _ALL_FLOOR) * noise
    given = common_miss(images)
    if given < max(floor, 0.002):
        return images, NOTHING
    turned = mirrored(images, list(range(len(images.names))))
    other = common_miss(turned)
    if other > _MAX_MIRRORED_RATIO * given:
        return images, NOTHING
    said = (
        f"the images seem to be mirrored: their rays miss each other by {100 * given:.1f} cm, and "
        f"by {100 * other:.1f} cm when left and right of all images are exchanged"
    )
    if other <= floor:
        done = f"{said}; they were mirrored back. Give the videos as they were filmed"
        return turned, Findings((Finding("mirrored", done, value=given),))
    todo = f"{said}; mirror the videos back before keypoints are detected"
    return images, Findings(warnings=(Finding("mirrored", todo, value=given),))


def another_image(images: Images) -> tuple[Images, Findings]:
    """One view that fits the others only when it is mirrored or scaled.

    Looked for before names are, as wrong pixels make names look wrong.
    """
    if len(images.names) < 3:
        return images, NOTHING
    return _one_explained(images, noise_of_views(images), ("mirrored", "sized"))


def _one_explained(
    images: Images, noise: float, causes: tuple[Cause, ...]
) -> tuple[Images, Findings]:
    """The view that a cause brings back to the noise, with the others at the noise."""
    floor = _FLOOR * noise
    best: tuple[float, int, float, Explained] | None = None
    for v in range(len(images.names)):
        odd = Odd.of(images, v)
        before = odd.miss()
        if before < _WORSE * floor or floor == 0:
            continue
        rest = common_miss(images.view([k for k in range(len(images.names)) if k != v]))
        chosen = _simplest(odd.explained(causes))
        total = rest + chosen.remains
        if rest <= floor and chosen.remains <= floor and (best is None or total < best[0]):
            best = (total, v, before, chosen)
    if best is None:
        return images, NOTHING
    _, v, before, chosen = best
    return chosen.images, Findings((_explained_finding(images.names[v], before, chosen),))


def _simplest(options: list[Explained]) -> Explained:
    least = min(option.remains for option in options)
    return next(option for option in options if option.remains <= _SIMPLER * least)


_CODES: dict[Cause, Code] = {
    "mirrored": "mirrored",
    "sized": "view at odds",
    "clock": "views out of step",
    "turned": "view at odds",
    "placed": "view at odds",
    "moving": "camera moves",
}


def _explained_finding(name: str, before: float, found: Explained) -> Finding:
    value = found.value
    late = "late" if value > 0 else "early"
    cause = {
        "mirrored": "its images are mirrored; they were mirrored back",
        "clock": f"its clock is {1000 * abs(value):.0f} ms {late}; its keypoints were moved in "
        "time. Number the frames of all cameras from the same moment",
        "turned": f"its camera is turned by {value:.1f} degrees against the calibration; the pose "
        "was corrected. Calibrate anew",
        "sized": f"its keypoints are {value:.2f} times as large as its calibration's image; they "
        "were scaled. Give keypoints and calibration of one resolution",
        "placed": f"its camera stands {value:.2f} m from where the calibration has it; the pose "
        "was corrected. Calibrate anew",
        "moving": f"its camera, declared fixed, turns by {value:.1f} degrees during the clip; its "
        "poses were estimated. Fix the camera, or give a pose for every frame",
    }[found.cause]
    return Finding(
        _CODES[found.cause],
        f"{name} contradicts the other views by {100 * before:.1f} cm, and by "
        f"{100 * found.remains:.1f} cm if {cause}",
        value=value if value else before,
    )


def _one_left_out(images: Images, noise: float) -> tuple[Images, Findings]:
    """A view that stays at odds: left out where the others agree, else warned of."""
    views = range(len(images.names))
    rest = [common_miss(images.view([k for k in views if k != v])) for v in views]
    v = int(np.argmin(rest))
    odd = Odd.of(images, v)
    before = odd.miss()
    name = images.names[v]
    agree = 0 < rest[v] <= _FLOOR * noise
    if before <= _AT_ODDS:
        return _stretches_left_out(images, odd, agree=agree)
    least = _simplest(odd.explained(tuple(_CODES)))
    hint = _HINTS[least.cause] if least.remains < _MAX_MIRRORED_RATIO * before else _SOMEBODY
    said = f"{name} contradicts the other views: its rays miss their points by {before:.2f} m"
    if agree:
        hidden = np.zeros_like(images.seen)
        hidden[v] = True
        text = f"{said}, while they agree with each other; it was left out. {hint}"
        return images.without(hidden), Findings((Finding("view at odds", text, value=before),))
    return images, Findings(warnings=(Finding("view at odds", f"{said}. {hint}", value=before),))


_SOMEBODY = (
    "Likeliest it shows another person, or the files and cameras of two views are mixed up; check "
    "who is followed (--person) and which calibration belongs to which view"
)
_HINTS: dict[Cause, str] = {
    "mirrored": "Its images seem to be mirrored; mirror them back before keypoints are detected",
    "clock": "Its clock seems to be off; number the frames of all cameras from the same moment",
    "turned": "Its camera seems to be turned; calibrate anew",
    "sized": "Its keypoints seem to be of another image size; give those of the calibration's",
    "placed": _SOMEBODY,
    "moving": _SOMEBODY,
}


def _stretches_left_out(images: Images, odd: Odd, *, agree: bool) -> tuple[Images, Findings]:
    """Moments at which one view is far from what the others see."""
    rays = Rays.of(images.view([odd.view]))
    there = odd.exists & (rays.weight[0] > 0)
    miss = np.where(there, rays.miss(odd.points)[0], np.nan)
    away = np.array([np.median(row[np.isfinite(row)]) if s.any() else 0.0
                     for row, s in zip(miss, there, strict=True)])  # fmt: skip
    bad = lasting(away > _AWAY, round(_STRETCH * images.fps))
    if not bad.any():
        return images, NOTHING
    name, frames = images.names[odd.view], stretches(bad)
    said = (
        f"{name} contradicts the other views by {float(np.median(away[bad])):.2f} m in "
        f"{spans(frames)}, as when it follows another person there"
    )
    size = float(np.median(away[bad]))
    if agree:
        hidden = np.zeros_like(images.seen)
        hidden[odd.view, bad] = True
        text = f"{said}; these frames of it were left out"
        done = Finding("view at odds", text, frames=frames, value=size)
        return images.without(hidden), Findings((done,))
    todo = Finding("view at odds", f"{said}; check who is followed", frames=frames, value=size)
    return images, Findings(warnings=(todo,))


def _two_views(images: Images, noise: float) -> tuple[Images, Findings]:
    """Two views contradict each other: their clocks are told, but not which pose is wrong."""
    given, floor = common_miss(images), _PAIR_FLOOR * noise
    if given <= max(_WORSE * floor, 0.002):
        return images, NOTHING
    names = " and ".join(images.names)
    said = f"{names} contradict each other: their rays miss by {100 * given:.1f} cm"
    timed = agreement(images, ("clock",))
    by = _out_of_step(images, timed)
    if timed.remains <= floor and timed.remains < _MAX_MIRRORED_RATIO * given:
        text = (
            f"{said}, and by {100 * timed.remains:.1f} cm if {by}; its keypoints were moved in "
            "time. Number the frames of all cameras from the same moment"
        )
        done = Finding("views out of step", text, value=timed.late / images.fps)
        return timed.images, Findings((done,))
    turned = agreement(images, ("pose",))
    both = agreement(images, ("clock", "pose"))
    if both.remains < turned.remains / _SIMPLER:
        turned = both
    if turned.remains <= floor and turned.remains < _MAX_MIRRORED_RATIO * given:
        late = f"{_out_of_step(images, turned)} and " if turned.late else ""
        text = (
            f"{said}, and by {100 * turned.remains:.1f} cm if {late}one of the cameras is turned "
            f"by {turned.degrees:.1f} degrees against the calibration. Two views do not tell "
            "which of them, so nothing was changed. Calibrate anew, see that the frames of both "
            "are numbered from the same moment, or add a view"
        )
        return images, Findings(warnings=(Finding("view at odds", text, value=given),))
    if given <= _PAIR_AT_ODDS:
        return images, NOTHING
    if timed.remains < _MAX_MIRRORED_RATIO * given:
        text = f"{said}; it seems that {by}"
        return images, Findings(warnings=(Finding("views out of step", text, value=given),))
    text = (
        f"{said}. Check that each has its own camera's calibration, in the image size of its "
        "keypoints, and that both show the same person at the same time"
    )
    return images, Findings(warnings=(Finding("view at odds", text, value=given),))


def _out_of_step(images: Images, found: Agreement) -> str:
    late = found.late / images.fps
    return f"{images.names[1]} is {1000 * abs(late):.0f} ms {'late' if late > 0 else 'early'}"
