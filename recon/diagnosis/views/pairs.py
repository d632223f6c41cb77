"""Two keypoints that carry each other's name: both go on along the other's path, or limbs stretch.

Where a stretch begins or ends, both keypoints jump onto each other's path. Which of the two parts
is wrong, and whether it is the whole clip, the bones of a limb tell: exchanged ends make one of
them longer than it is.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.diagnosis.findings import Finding, Findings, spans
from recon.diagnosis.views.images import Images

_OFF = 0.08
"""Metres by which both keypoints leave their own paths when their names are exchanged."""
_ON = 0.5
"""Share of that by which they may then miss the other's path."""
_USUAL = 5.0
"""Multiple of the usual distance from their paths by which both keypoints must leave them."""
_FEW = 0.35
"""Share of the keypoints that may leave their paths at that moment; more is the whole body."""
_LONGER = 1.1
"""Times a bone's length at the body's size that it may be in an image."""
_STRETCHED = 0.03
"""Metres by which bones of a limb are on average too long when two of its ends are exchanged
throughout; in good windows of validation people exchanging never saves that."""
_LIMBS = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))


@dataclass(frozen=True)
class ExchangedPair:
    """Two keypoints of a view with each other's name, from the first to the last moment."""

    view: int
    points: tuple[int, int]
    first: int
    last: int
    distance: float
    """Metres by which both jumped, or by which bones were too long."""


def repaired_pairs(images: Images) -> tuple[Images, Findings]:
    """The images with exchanged keypoints given back their names, and what was found."""
    found: list[Finding] = []
    for find in (exchanged_for_a_while, exchanged_throughout):
        for one in find(images):
            images = _renamed(images, one)
            found.append(_finding(images, one))
    return images, Findings(tuple(found))


def exchanged_for_a_while(images: Images) -> list[ExchangedPair]:
    """The stretches in which two keypoints of one view exchange their names.

    A jump of both along each other's path begins a stretch, the next one ends it.
    """
    found: list[ExchangedPair] = []
    for v in range(len(images.names)):
        events: dict[tuple[int, int], list[tuple[int, float]]] = {}
        for t, a, b, away in _events(images, v):
            events.setdefault((a, b), []).append((t, away))
        for pair, times in events.items():
            found += _stretches(images, v, pair, times)
    return found


def exchanged_throughout(images: Images) -> list[ExchangedPair]:
    """Neighbours along a limb whose exchange makes bones no longer than they are."""
    last = images.pixels.shape[1] - 1
    found: list[ExchangedPair] = []
    for v in range(len(images.names)):
        for pair in _neighbours(images):
            saved = _saved(images, v, pair)
            if saved.size and (mean := float(saved.mean())) > _STRETCHED:
                found.append(ExchangedPair(v, pair, 0, last, mean))
    return found


def _renamed(images: Images, one: ExchangedPair) -> Images:
    pixels, confidence = images.pixels.copy(), images.confidence.copy()
    when, both = slice(one.first, one.last + 1), list(one.points)
    pixels[one.view, when, both] = pixels[one.view, when, both[::-1]]
    confidence[one.view, when, both] = confidence[one.view, when, both[::-1]]
    return images.named(pixels, confidence)


def _finding(images: Images, one: ExchangedPair) -> Finding:
    a, b = (images.points[k] for k in one.points)
    throughout = one.first == 0 and one.last == images.pixels.shape[1] - 1
    frames = () if throughout else ((one.first, one.last),)
    when = "throughout" if throughout else f"in {spans(frames)}"
    return Finding(
        "points exchanged",
        f"{a} and {b} carry each other's name {when}, as they jump onto each other's path or "
        "stretch the limb; they were given back their names",
        (a, b),
        frames,
        one.distance,
    ).of(images.names[one.view])


def _stretches(
    images: Images, view: int, pair: tuple[int, int], times: list[tuple[int, float]]
) -> list[ExchangedPair]:
    """The wrong moments between jumps: those that stretch bones, else the fewer."""
    moments = images.pixels.shape[1]
    events = sorted(times)
    exchanged = np.zeros(moments, dtype=bool)
    for t, _ in events:
        exchanged[t:] ^= True
    saved = np.nan_to_num(_saved(images, view, pair, every=True))
    inside, outside = saved[exchanged].sum(), saved[~exchanged].sum()
    if outside > inside or (outside == inside and exchanged.mean() > 0.5):
        exchanged = ~exchanged
    size = min(away for _, away in events)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], exchanged.astype(np.int8), [0]))))
    return [
        ExchangedPair(view, pair, int(a), int(b) - 1, size)
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]


def _events(images: Images, view: int) -> list[tuple[int, int, int, float]]:
    """Moments at which two keypoints jump onto each other's path: moment, both, metres."""
    seen, place = images.seen[view], images.pixels[view]
    if len(place) < 3:
        return []
    before = np.where(seen[:-1, :, None], place[:-1], np.nan)
    there = before.copy()
    moving = seen[1:-1] & seen[:-2]
    there[1:] += np.where(moving[..., None], place[1:-1] - place[:-2], 0.0)
    now = np.where(seen[1:, :, None], place[1:], np.nan)
    scale = images.scale[view, 1:, None]
    own: Float[np.ndarray, "steps points"] = np.linalg.norm(now - there, axis=-1) / scale
    known = np.isfinite(own)
    usual = float(np.median(own[known])) if known.any() else 0.0
    off = known & (own > max(_OFF, _USUAL * usual))
    few = off.sum(-1) <= np.maximum(2, _FEW * known.sum(-1))
    found: list[tuple[int, int, int, float]] = []
    for t in np.flatnonzero((off.sum(-1) >= 2) & few).tolist():
        rows = np.flatnonzero(off[t])
        ways = now[t][rows][:, None] - there[t][rows][None]
        ratio = np.linalg.norm(ways, axis=-1) / scale[t] / own[t][rows][:, None]
        for i, j in np.argwhere(np.triu(np.maximum(ratio, ratio.T) < _ON, 1)):
            both = rows[[i, j]]
            away = float(own[t, both].min())
            if t + 1 == len(now) or not (_leave(now, scale, t)[both] > _ON * away).any():
                found.append((t + 1, int(both[0]), int(both[1]), away))
    return found


def _leave(now: np.ndarray, scale: np.ndarray, step: int) -> Float[np.ndarray, " points"]:
    """Metres by which points move on after a step; outliers do not stay where they jump to."""
    return np.nan_to_num(np.linalg.norm(now[step + 1] - now[step], axis=-1) / scale[step])


def _neighbours(images: Images) -> list[tuple[int, int]]:
    """Keypoints that follow each other along a limb and are not at its root."""
    return [
        (images.points.index(f"{side}_{b}"), images.points.index(f"{side}_{c}"))
        for side in ("left", "right")
        for a, b, c in _LIMBS
        if {f"{side}_{a}", f"{side}_{b}", f"{side}_{c}"} <= set(images.points)
    ]


def _saved(
    images: Images, view: int, pair: tuple[int, int], *, every: bool = False
) -> Float[np.ndarray, " moments"]:
    """Metres by which bones are too long as named, less those after an exchange.

    Only of moments at which the whole limb is seen, or of every moment, NaN where it is not;
    zero for keypoints that are no neighbours on a limb.
    """
    if pair not in _neighbours(images):
        return np.zeros(images.pixels.shape[1] if every else 0)
    side, _, middle = images.points[pair[0]].partition("_")
    root = images.points.index(f"{side}_{next(a for a, b, _ in _LIMBS if b == middle)}")
    there = images.seen[view][:, [root, *pair]].all(-1)
    length = _LONGER * np.linalg.norm(images.rest[root] - images.rest[pair[0]])

    def excess(end: int) -> np.ndarray:
        way = images.pixels[view, :, root] - images.pixels[view, :, end]
        return np.maximum(np.linalg.norm(way, axis=-1) / images.scale[view] - length, 0.0)

    saved = np.where(there, excess(pair[0]) - excess(pair[1]), np.nan)
    return saved if every else saved[there]
