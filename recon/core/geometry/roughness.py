"""How noisy the depths of a sensor are, told from neighbouring points alone."""

import numpy as np
from jaxtyping import Bool, Float

from recon.core.robust import NORMAL_MAD

_NEIGHBOURS = 8
_LEAST = 30
"""Points of a moment that tell its noise."""
_MOMENTS = 30
"""Moments that are looked at; noise changes as slowly as distance."""
_AROUND = 2
"""Looked-at moments to either side whose median one takes."""
_WILD = 3.0
"""Multiple of the median deviation beyond which a point flies, and is no neighbour."""


def depth_noise(
    points: Float[np.ndarray, "moments points 3"],
    present: Bool[np.ndarray, "moments points"],
    eye: Float[np.ndarray, "moments 3"],
) -> Float[np.ndarray, " moments"]:
    """Standard deviation of distances from the sensor at every moment, metres.

    Every point is compared with the plane through its neighbours in the image: a deviation is
    noise, or the curvature of limbs where points are sparse (half a thousand points of a body
    0.5 to 1 cm). The median of the deviations sees neither edges nor flying pixels. Moments with
    few points take the value of the nearest one with more; without any, it is zero.

    Args:
        points: of the surface, metres.
        present: which of them exist.
        eye: the sensor's place at every moment, metres.
    """
    enough = np.flatnonzero(present.sum(1) >= _LEAST)
    if len(enough) == 0:
        return np.zeros(len(points))
    looked = enough[:: -(-len(enough) // _MOMENTS)]
    found: list[float] = []
    for moment in looked:
        away = (points[moment, present[moment]] - eye[moment]).astype(np.float64)
        deviations = _deviations(away)
        kept = deviations <= _WILD * np.median(deviations)
        found.append(float(np.median(_deviations(away[kept]))) / NORMAL_MAD)
    padded = np.pad(found, _AROUND, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
    return np.interp(np.arange(len(points)), looked, np.median(around, 1))


def _deviations(away: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, " points"]:
    """Sizes of the deviations of points from the planes through their neighbours, along rays."""
    from scipy.spatial import KDTree

    far = np.linalg.norm(away, axis=1)
    rays = away / np.maximum(far, 1e-9)[:, None]
    near = np.asarray(KDTree(rays).query(rays, k=_NEIGHBOURS + 1)[1])[:, 1:]
    # in the plane across the mean ray, where neighbours span two directions
    _, _, axes = np.linalg.svd(rays.mean(0)[None])
    image = rays @ axes[1:].T
    beside = image[near] - image[:, None]
    scale = np.maximum(np.abs(beside).max((1, 2)), 1e-9)[:, None, None]
    design = np.concatenate((np.ones((*near.shape, 1)), beside / scale), 2)
    normal = design.transpose(0, 2, 1) @ design + 1e-6 * np.eye(3)
    inverse = np.linalg.inv(normal)
    plane = inverse @ (design.transpose(0, 2, 1) @ far[near][..., None])
    # the plane at the point itself is off by the noise of its neighbours
    spread = np.sqrt(1 + inverse[:, 0, 0])
    return np.abs(far - plane[:, 0, 0]) / spread
