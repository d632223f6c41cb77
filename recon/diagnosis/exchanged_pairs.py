"""Repairs exchanged names of two keypoints of one view: left and right, or limb neighbours.

Two keypoints jump onto each other's path where a stretch with exchanged names begins or ends; the
bones of the limb show which part is wrong, as exchanged ends make one of them too long. In a
single view a fit must confirm the exchange.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import Finding, Findings, listed, spans, stretches
from recon.diagnosis.images import (
    Images,
    bone_length_saved,
    keeps_facing_one_side,
    limb_root_by_keypoint_pair,
    undoing_improves_fit,
)

_MIN_JUMP_M = 0.08
"""Distance (m) by which both keypoints leave their own paths when their names are exchanged."""
_MAX_MISS_SHARE = 0.5
"""Distance of a jumping keypoint from the other's path, as a share of that from its own path."""
_MIN_JUMP_RATIO = 5.0
"""Distance of both keypoints from their own paths, as a multiple of what is usual."""
_MAX_JUMPING_SHARE = 0.35
"""Share of the keypoints that may jump in one frame; if more do, the whole body jumps."""
_MIN_LENGTH_SAVED_M = 0.03
"""Metres by which the bones of a limb are on average too long when two of its ends are exchanged
throughout; in good windows of validation people exchanging never saves as much."""
_MAX_EXCURSION = 3
"""Largest number of frames for which a point may leave its path and come back."""


@dataclass(frozen=True)
class ExchangedPair:
    """Two keypoints of a view that have each other's name in a range of frames."""

    view: int
    points: tuple[int, int]
    first: int
    last: int
    distance: float
    """Distance (m) that both jumped, bones were too long by, or rays missed each other by."""


def repaired_pairs(images: Images) -> tuple[Images, Findings]:
    """Undo exchanges of two keypoints' names that single views show; also return findings.

    If there is only one view, a fit must confirm exchanges that jumps suggest; unconfirmed ones
    become warnings.
    """
    jumping, doubted = exchanged_for_a_while(images), list[ExchangedPair]()
    if len(images.names) == 1 and jumping:
        jumping, doubted = _confirmed_pairs(images, jumping)
    jumps = "they jump onto each other's path"
    images, found = repaired_by(images, jumping, jumps)
    found += Findings(warnings=_pair_findings(images, doubted, jumps, sure=False))
    images, more = repaired_by(images, exchanged_throughout(images), "they stretch the limb")
    return images, found + more


def _confirmed_pairs(
    images: Images, found: list[ExchangedPair]
) -> tuple[list[ExchangedPair], list[ExchangedPair]]:
    """Return the exchanges in one view whose undoing improves a fit, and those left doubtful."""
    sure, doubted = list[ExchangedPair](), list[ExchangedPair]()
    for (first, last), own in _pairs_by_stretch(found).items():
        after = exchanged_back(images, own)
        ends = [t for t in (first, last + 1) if 0 < t < images.pixels.shape[1]]
        better = bool(undoing_improves_fit(images, after, np.array(ends)).all())
        confirmed = better and (len(ends) == 2 or keeps_facing_one_side(after))
        (sure if confirmed else doubted).extend(own)
    return sure, doubted


def _pairs_by_stretch(
    found: Sequence[ExchangedPair],
) -> dict[tuple[int, int], list[ExchangedPair]]:
    """Group exchanged pairs of one view by their first and last frame."""
    own: dict[tuple[int, int], list[ExchangedPair]] = {}
    for one in found:
        own.setdefault((one.first, one.last), []).append(one)
    return own


def repaired_by(
    images: Images, found: Sequence[ExchangedPair], reason: str
) -> tuple[Images, Findings]:
    """Return images with exchanged pairs put right, and findings with the given reason."""
    return exchanged_back(images, found), Findings(_pair_findings(images, found, reason))


def _pair_findings(
    images: Images, found: Sequence[ExchangedPair], reason: str, *, sure: bool = True
) -> tuple[Finding, ...]:
    return tuple(
        _pair_finding(images, reason, view, *stretch, own, sure=sure)
        for view in range(len(images.names))
        for stretch, own in _pairs_by_stretch([one for one in found if one.view == view]).items()
    )


def exchanged_back(images: Images, found: Sequence[ExchangedPair]) -> Images:
    """Return images in which the two keypoints of every given pair have swapped positions."""
    pixels, confidence = images.pixels.copy(), images.confidence.copy()
    for one in found:
        when, both = slice(one.first, one.last + 1), [*one.points]
        for values in (pixels, confidence):
            values[one.view, when, both] = values[one.view, when, both[::-1]]
    return replace(images, pixels=pixels, confidence=confidence)


def _pair_finding(
    images: Images,
    reason: str,
    view: int,
    first: int,
    last: int,
    pairs: list[ExchangedPair],
    *,
    sure: bool,
) -> Finding:
    names = tuple(images.points[k] for one in pairs for k in one.points)
    throughout = first == 0 and last == images.pixels.shape[1] - 1
    frames = () if throughout else ((first, last),)
    when = "throughout" if throughout else f"in {spans(frames)}"
    said = (
        f"{listed(names)} have each other's name {when}, as {reason}; names were exchanged back"
        if sure
        else f"{listed(names)} may have each other's name {when}: {reason}. One view does not "
        "tell for sure, and they kept their names; look at these frames"
    )
    return Finding(
        "points exchanged",
        said,
        names,
        frames,
        max(one.distance for one in pairs),
    ).of_sensor(images.names[view])


def exchanged_for_a_while(images: Images) -> list[ExchangedPair]:
    """Find stretches in which two keypoints of one view have each other's names.

    A jump of both onto each other's path begins a stretch, the next one ends it. The frames with
    too long bones are the wrong ones, or else the smaller number of frames.
    """
    found: list[ExchangedPair] = []
    steady = without_excursions(images)
    for v in range(len(images.names)):
        for pair, jumps in _jumps_onto_each_other(steady, v).items():
            exchanged = np.zeros(images.pixels.shape[1], dtype=bool)
            for t in jumps:
                exchanged[t:] ^= True
            saved = np.nan_to_num(bone_length_saved(images, v, pair))
            inside, outside = saved[exchanged].sum(), saved[~exchanged].sum()
            if outside > inside or (outside == inside and exchanged.mean() > 0.5):
                exchanged = ~exchanged
            away = min(jumps.values())
            found += [ExchangedPair(v, pair, a, b, away) for a, b in stretches(exchanged)]
    return found


def exchanged_throughout(images: Images) -> list[ExchangedPair]:
    """Find neighbouring keypoints of a limb whose names are exchanged in all frames.

    Exchanging them makes the limb's bones plausibly short.
    """
    last = images.pixels.shape[1] - 1
    found: list[ExchangedPair] = []
    for v in range(len(images.names)):
        for pair in limb_root_by_keypoint_pair(images):
            saved = bone_length_saved(images, v, pair)
            known = saved[np.isfinite(saved)]
            if known.size and (mean := float(known.mean())) > _MIN_LENGTH_SAVED_M:
                found.append(ExchangedPair(v, pair, 0, last, mean))
    return found


def _jumps_onto_each_other(images: Images, view: int) -> dict[tuple[int, int], dict[int, float]]:
    """Find frames where two keypoints jump onto each other's path, with the distances (m).

    Outliers, which do not stay where they jump to, are left out.
    """
    before, known = (values[0] for values in extrapolated(images.view([view])))
    now, scale = images.pixels[view], images.scale[view, :, None]
    known &= images.seen[view]
    own = np.where(known, np.linalg.norm(now - before, axis=-1) / scale, 0.0)
    usual = float(np.median(own[known])) if known.any() else 0.0
    off = known & (own > max(_MIN_JUMP_M, _MIN_JUMP_RATIO * usual))
    few = off.sum(-1) <= np.maximum(2, _MAX_JUMPING_SHARE * known.sum(-1))
    found: dict[tuple[int, int], dict[int, float]] = {}
    for t in np.flatnonzero((off.sum(-1) >= 2) & few).tolist():
        rows = np.flatnonzero(off[t])
        ways = np.linalg.norm(now[t, rows][:, None] - before[t, rows], axis=-1)
        ratio = ways / scale[t] / own[t, rows][:, None]
        for pair in np.argwhere(np.triu(np.maximum(ratio, ratio.T) < _MAX_MISS_SHARE, 1)):
            both = rows[pair]
            away = float(own[t, both].min())
            if t + 1 < len(now):
                leave = np.linalg.norm(now[t + 1, both] - now[t, both], axis=-1) / scale[t]
                if (images.seen[view, t + 1, both] & (leave > _MAX_MISS_SHARE * away)).any():
                    continue
            found.setdefault((int(both[0]), int(both[1])), {})[t] = away
    return found


def without_excursions(images: Images) -> Images:
    """Return the images with short excursions of keypoints replaced by straight paths.

    Detectors that fail for up to three frames put a point between left and right; extrapolated
    from there, its path would lead to the counterpart's, and its true place would look exchanged.
    Points that lie where their counterpart was stay as they are: that is an exchange.
    """
    place, seen = images.pixels.copy(), images.seen
    for length in range(1, _MAX_EXCURSION + 1):
        step = length + 1
        before, after = images.pixels[:, :-step], images.pixels[:, step:]
        scale = images.scale[:, :-step, None]
        back = np.linalg.norm(after - before, axis=-1) / scale
        away = np.ones_like(back, dtype=bool) & seen[:, :-step] & seen[:, step:]
        for k in range(1, step):
            there = images.pixels[:, k : k - step]
            left = np.linalg.norm(there - before, axis=-1) / scale
            other = np.linalg.norm(there - before[:, :, images.counterparts], axis=-1) / scale
            away &= (left > _MIN_JUMP_M) & (left > 2 * back)
            away &= (other > _MAX_MISS_SHARE * left) | ~images.sided
        for k in range(1, step):
            line = before + (after - before) * k / step
            place[:, k : k - step] = np.where(away[..., None], line, place[:, k : k - step])
    return replace(images, pixels=place)


def extrapolated(
    images: Images,
) -> tuple[Float[np.ndarray, "views moments points 2"], Bool[np.ndarray, "views moments points"]]:
    """Predict every keypoint from the two previous frames; also return a mask of predictions.

    A keypoint that was not seen two frames before is predicted where it was one frame before.
    """
    seen, place = images.seen, images.pixels
    before, known = np.zeros_like(place), np.zeros_like(seen)
    before[:, 1:], known[:, 1:] = place[:, :-1], seen[:, :-1]
    moving = (seen[:, 1:-1] & seen[:, :-2])[..., None]
    before[:, 2:] += np.where(moving, place[:, 1:-1] - place[:, :-2], 0.0)
    return before, known
