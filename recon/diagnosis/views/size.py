"""How large a person several calibrated cameras see, which tells the scale of the calibration."""

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import Finding
from recon.diagnosis.views.images import Images
from recon.diagnosis.views.rays import Rays

_BONES = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
    ("shoulder", "hip"),
)  # fmt: skip
_SMALLEST, _LARGEST = 0.7, 1.17
"""Sizes against the average body, of 1.70 m: a child of 1.20 m, an adult of 2.00 m."""
_FEWEST = 10
"""Moments at which a bone must be seen for its length to count."""


def body_size(images: Images) -> float | None:
    """Size of the triangulated body against the average one; None where too little is seen."""
    points, exists = Rays.of(images).meet()
    ratios = [
        float(np.median(length[both]) / np.linalg.norm(images.rest[a] - images.rest[b]))
        for a, b in _ends(images)
        for length, both in [_length(points, exists, a, b)]
        if both.sum() >= _FEWEST
    ]
    return float(np.median(ratios)) if len(ratios) >= 4 else None


def scale_findings(images: Images) -> list[Finding]:
    """Whether everything is larger or smaller than people are."""
    size = body_size(images) if len(images.names) > 1 else None
    if size is None or _SMALLEST < size < _LARGEST:
        return []
    return [
        Finding(
            "scale",
            f"the cameras see a person {size:.2f} times as large as the average one: their "
            "positions seem to be in another unit, or the pattern of the calibration to have "
            "another size than was given (--camera-unit; a person of "
            f"{1.7 * size:.2f} m is right as it is)",
            value=size,
        )
    ]


def _ends(images: Images) -> list[tuple[int, int]]:
    return [
        (images.points.index(f"{side}_{a}"), images.points.index(f"{side}_{b}"))
        for side in ("left", "right")
        for a, b in _BONES
        if {f"{side}_{a}", f"{side}_{b}"} <= set(images.points)
    ]


def _length(
    points: Float[np.ndarray, "moments points 3"],
    exists: Bool[np.ndarray, "moments points"],
    a: int,
    b: int,
) -> tuple[np.ndarray, np.ndarray]:
    return np.linalg.norm(points[:, a] - points[:, b], axis=-1), exists[:, a] & exists[:, b]
