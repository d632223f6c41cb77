"""Facts about images that need no model: keypoints at exactly zero, and such as repeat exactly.

Detectors are noisy, so no keypoint has the same coordinates twice in a row; software that fills
what it has lost writes zeros, the last place, or the whole last frame again.
"""

import numpy as np
from jaxtyping import Bool, Int

from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.diagnosis.views.images import Images

_MIN_HELD_MOMENTS = 4
"""Moments in a row at one place from which on a keypoint counts as held; two or three may be
chance where a detector writes whole pixels."""
_LONGER = 3
"""Multiple of the usual number of moments at one place from which on a keypoint counts as held."""
_ALIKE = 0.9
"""Share of a frame's keypoints that must repeat for the frame to be a copy."""
_MIN_KEYPOINTS = 5
"""Keypoints in a frame from which on one can speak of a copy."""
_MIN_PHOTOGRAPH_SHARE = 0.8
"""Share of copied frames from which on a view is a photograph rather than a film with copies."""

Found = tuple[Images, list[Finding]]


def repaired_zeros(images: Images) -> Found:
    """Keypoints at (0, 0) are made unseen: that is how missing ones are often written."""
    zero = images.seen & (images.pixels == 0).all(-1)
    return images.without(zero), [
        Finding(
            "zeros",
            f"{name}: {here.sum() / images.seen[v].sum():.2g} of the keypoints with a confidence "
            f"lie at exactly (0, 0), which is how missing ones are often written "
            f"({listed(_names(images, here))}); they were taken as not seen. Write a confidence "
            "of 0 for them",
            _names(images, here),
            stretches(here.any(-1)),
            float(here.sum() / images.seen[v].sum()),
        )
        for v, (name, here) in enumerate(zip(images.names, zero, strict=True))
        if here.any()
    ]


def repaired_copies(images: Images) -> Found:
    """Frames that are exact copies of the one before are made unseen."""
    if images.pixels.shape[1] < 2:
        return images, []
    same = _same(images)
    both = images.seen[:, 1:] & images.seen[:, :-1]
    enough = both.sum(-1) >= _MIN_KEYPOINTS
    copied = enough & (same[:, 1:].sum(-1) >= _ALIKE * both.sum(-1))
    copied[copied.mean(-1) > _MIN_PHOTOGRAPH_SHARE] = False
    copied = np.pad(copied, ((0, 0), (1, 0)))
    return images.without(np.repeat(copied[..., None], len(images.points), -1)), [
        Finding(
            "repeated frames",
            f"{name}: {here.sum()} frames are exact copies of the frame before them; they were "
            "taken as not seen. A film that was brought to a higher rate by repeating frames "
            "should be given at its own rate",
            (),
            stretches(here),
            float(here.mean()),
        )
        for name, here in zip(images.names, copied, strict=True)
        if here.any()
    ]


def repaired_held(images: Images) -> Found:
    """Keypoints that stay at exactly one place while others move are made unseen there."""
    since = _run_lengths(_same(images))
    length = _whole_runs(since)
    usual = np.median(length.max(1), -1)
    held = (since > 0) & (
        length >= np.maximum(_MIN_HELD_MOMENTS - 1, _LONGER * (usual[:, None, None] + 1))
    )
    return images.without(held), [
        Finding(
            "constant point",
            f"{name}: {listed(_names(images, here))} stayed at exactly the same pixel in "
            f"{spans(stretches(here.any(-1)))} while other keypoints moved, as software writes "
            "that repeats the last place of what it has lost; they were taken as not seen there",
            _names(images, here),
            stretches(here.any(-1)),
            float(here.sum(0).max() / images.fps),
        )
        for name, here in zip(images.names, held, strict=True)
        if here.any()
    ]


def _names(images: Images, here: Bool[np.ndarray, "moments points"]) -> tuple[str, ...]:
    return tuple(n for n, some in zip(images.points, np.asarray(here.any(0)), strict=True) if some)


def _same(images: Images) -> Bool[np.ndarray, "views moments points"]:
    """Keypoints that are where they were at the moment before, bit for bit."""
    same = np.zeros_like(images.seen)
    same[:, 1:] = (images.pixels[:, 1:] == images.pixels[:, :-1]).all(-1)
    same[:, 1:] &= images.seen[:, 1:] & images.seen[:, :-1]
    return same


def _run_lengths(
    same: Bool[np.ndarray, "views moments points"],
) -> Int[np.ndarray, "views moments points"]:
    """How many moments in a row a keypoint has stayed where it is."""
    count = np.zeros(same.shape, dtype=np.int64)
    for t in range(1, same.shape[1]):
        count[:, t] = np.where(same[:, t], count[:, t - 1] + 1, 0)
    return count


def _whole_runs(
    count: Int[np.ndarray, "views moments points"],
) -> Int[np.ndarray, "views moments points"]:
    """The final length of the run that every moment belongs to."""
    whole = count.copy()
    for t in range(count.shape[1] - 2, -1, -1):
        going_on = count[:, t + 1] == count[:, t] + 1
        inside = going_on & (count[:, t] > 0)
        whole[:, t] = np.where(inside, whole[:, t + 1], count[:, t])
    return whole
