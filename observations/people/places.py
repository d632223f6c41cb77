"""Sizes, distances and doubles of detections in an image."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from recon.core.layouts import keypoint_names
from recon.formats.detections.records import Detections

FEWEST_KEYPOINTS = 4
"""Detections with fewer are no people."""
_PIECE = 0.15
"""Detections with hardly a keypoint in common, each so close to the last sight of somebody,
keypoint by keypoint, are pieces of one body."""


def body_size(
    pixels: Float[np.ndarray, "points 2"], confidence: Float[np.ndarray, " points"]
) -> float:
    """Diagonal of the box around the keypoints seen, pixels; at least one."""
    seen = pixels[confidence > 0]
    return max(float(np.linalg.norm(np.ptp(seen, axis=0))), 1.0) if len(seen) > 0 else 1.0


def size_of(detections: Detections, row: int) -> float:
    """Body size of a detection, pixels."""
    return body_size(detections.pixels[row], detections.confidence[row])


def trunk_of(detections: Detections, row: int) -> float:
    """Logarithm of the length of the trunk in the image, pixels; NaN where it is not seen."""
    names = keypoint_names(detections.layout)
    ends: list[np.ndarray] = []
    for part in ("shoulder", "hip"):
        pair = [names.index(f"{s}_{part}") for s in ("left", "right") if f"{s}_{part}" in names]
        if len(pair) < 2 or not (detections.confidence[row, pair] > 0).all():
            return float("nan")
        ends.append(detections.pixels[row, pair].mean(0))
    return float(np.log(max(np.linalg.norm(ends[0] - ends[1]), 1.0)))


def middle_of(detections: Detections, row: int) -> Float[np.ndarray, "1 2"]:
    """Mean place of the keypoints of a detection."""
    return detections.pixels[row, detections.confidence[row] > 0].mean(0, keepdims=True)


def gap(detections: Detections, a: int, b: int) -> float:
    """Mean distance of the keypoints both show, in body sizes; infinite when they are too few."""
    both = (detections.confidence[a] > 0) & (detections.confidence[b] > 0)
    if both.sum() < FEWEST_KEYPOINTS:
        return float("inf")
    away = np.linalg.norm(detections.pixels[a, both] - detections.pixels[b, both], axis=-1).mean()
    return float(away) / _larger(detections, a, b)


def reshaping(detections: Detections, a: int, b: int) -> float:
    """Change of the pose: the gap without what the ways of all keypoints have in common."""
    both = (detections.confidence[a] > 0) & (detections.confidence[b] > 0)
    if both.sum() < FEWEST_KEYPOINTS:
        return float("inf")
    away = detections.pixels[a, both] - detections.pixels[b, both]
    apart = np.linalg.norm(away - np.median(away, axis=0), axis=-1).mean()
    return float(apart) / _larger(detections, a, b)


def distance(detections: Detections, a: int, b: int) -> float:
    """Distance of the centres of two detections, over the keypoints both show, in body sizes."""
    seen_a, seen_b = detections.confidence[a] > 0, detections.confidence[b] > 0
    both = seen_a & seen_b
    if both.sum() >= FEWEST_KEYPOINTS:
        seen_a = seen_b = both
    way = detections.pixels[a, seen_a].mean(0) - detections.pixels[b, seen_b].mean(0)
    return float(np.linalg.norm(way)) / _larger(detections, a, b)


def whole(detections: Detections, rows: Sequence[int], last: Sequence[int]) -> list[int]:
    """Detections of a frame without those that are a lesser piece of a body seen before.

    Args:
        detections: of one view.
        rows: those of the frame.
        last: the last detections of everybody seen before.
    """
    strength = detections.confidence.sum(1)
    near = {row: {own for own in last if gap(detections, own, row) < _PIECE} for row in rows}
    lesser: set[int] = set()
    for a in near:
        for b in near:
            apart = (detections.confidence[[a, b]] > 0).all(0).sum() < FEWEST_KEYPOINTS
            if near[a] & near[b] and apart and strength[a] < strength[b]:
                lesser.add(a)
    return [row for row in rows if row not in lesser]


def _larger(detections: Detections, a: int, b: int) -> float:
    return max(size_of(detections, a), size_of(detections, b))
