"""Facts about images that need no model: keypoints at exactly zero, and such as repeat exactly.

Detectors are noisy, so no keypoint has the same coordinates twice in a row; software that fills
what it has lost writes zeros, the last place, or the whole last frame again.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Int

from recon.diagnosis.findings import Finding, Findings, listed, spans, stretches
from recon.diagnosis.views.images import Images

_MIN_HELD_MOMENTS = 4
"""Moments in a row at one place from which on a keypoint counts as held; two or three may be
chance where a detector writes whole pixels."""
_LONGER = 3
"""Multiple of the usual number of moments at one place from which on a keypoint counts as held."""
_MIN_REPEATED_SHARE, _MIN_KEYPOINTS = 0.9, 5
"""Share of a frame's keypoints that must repeat for the frame to be a copy, and their number."""
_MIN_PHOTOGRAPH_SHARE = 0.8
"""Share of copied frames from which on a view is a photograph rather than a film with copies."""

Seen = Bool[np.ndarray, "moments points"]


def repaired_zeros(images: Images) -> tuple[Images, Findings]:
    """Keypoints at (0, 0) are made unseen: that is how missing ones are often written."""

    def said(v: int, here: Seen) -> Finding:
        share = here.sum() / images.seen[v].sum()
        return Finding(
            "zeros",
            f"{share:.2g} of the keypoints with a confidence lie at exactly (0, 0), which is how "
            f"missing ones are often written ({listed(_names(images, here))}); they were taken as "
            "not seen. Write a confidence of 0 for them",
            _names(images, here),
            stretches(np.any(here, axis=-1)),
            float(share),
        )

    return hidden(images, images.seen & (images.pixels == 0).all(-1), said)


def repaired_copies(images: Images) -> tuple[Images, Findings]:
    """Frames that are exact copies of the one before are made unseen."""
    both = (images.seen[:, 1:] & images.seen[:, :-1]).sum(-1)
    same = _same(images)[:, 1:].sum(-1)
    copied = (both >= _MIN_KEYPOINTS) & (same >= _MIN_REPEATED_SHARE * both)
    photographs = copied.sum(-1) > _MIN_PHOTOGRAPH_SHARE * copied.shape[1]
    copied = np.pad(copied & ~photographs[:, None], ((0, 0), (1, 0)))

    def said(_: int, here: Seen) -> Finding:
        frames = np.any(here, axis=-1)
        return Finding(
            "repeated frames",
            f"{frames.sum()} frames are exact copies of the frame before them; they were taken as "
            "not seen. A film that was brought to a higher rate by repeating frames should be "
            "given at its own rate",
            (),
            stretches(frames),
            float(frames.mean()),
        )

    return hidden(images, np.repeat(copied[..., None], len(images.points), -1), said)


def repaired_held(images: Images) -> tuple[Images, Findings]:
    """Keypoints that stay at exactly one place while others move are made unseen there."""
    length = _run_lengths(_same(images))
    usual = np.median(length.max(1), -1)
    held = length >= np.maximum(_MIN_HELD_MOMENTS - 1, _LONGER * (usual[:, None, None] + 1))

    def said(_: int, here: Seen) -> Finding:
        frames = stretches(np.any(here, axis=-1))
        return Finding(
            "constant point",
            f"{listed(_names(images, here))} stayed at exactly the same pixel in {spans(frames)} "
            "while other keypoints moved, as software writes that repeats the last place of what "
            "it has lost; they were taken as not seen there",
            _names(images, here),
            frames,
            float(here.sum(0).max() / images.fps),
        )

    return hidden(images, held, said)


def hidden(
    images: Images,
    keypoints: Bool[np.ndarray, "views moments points"],
    said: Callable[[int, Seen], Finding],
) -> tuple[Images, Findings]:
    """The images with some keypoints made unseen, and what is said of each view that has such."""
    rows = [v for v, here in enumerate(keypoints) if here.any()]
    repairs = tuple(said(v, keypoints[v]).of(images.names[v]) for v in rows)
    return images.without(keypoints), Findings(repairs)


def _names(images: Images, here: Seen) -> tuple[str, ...]:
    return tuple(n for n, some in zip(images.points, np.any(here, axis=0), strict=True) if some)


def _same(images: Images) -> Bool[np.ndarray, "views moments points"]:
    """Keypoints that are where they were at the moment before, bit for bit."""
    same = np.zeros_like(images.seen)
    same[:, 1:] = (images.pixels[:, 1:] == images.pixels[:, :-1]).all(-1)
    same[:, 1:] &= images.seen[:, 1:] & images.seen[:, :-1]
    return same


def _run_lengths(
    same: Bool[np.ndarray, "views moments points"],
) -> Int[np.ndarray, "views moments points"]:
    """How many moments in a row a keypoint stays where it is, at each of these moments."""
    length = np.zeros(same.shape, dtype=np.int64)
    for view, point in np.ndindex(same.shape[0], same.shape[2]):
        for first, last in stretches(same[view, :, point]):
            length[view, first : last + 1, point] = last - first + 1
    return length
