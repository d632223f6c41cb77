"""Whether triangulated keypoints have left and right where a body that faces forwards has them."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

_ANKLES, _TOES = ("heel", "ankle"), ("big_toe", "foot", "small_toe")
_LEAST = 0.02
"""Metres by which something must stick out forwards for its direction to count."""
_BENT = 0.06
"""Metres by which a knee must stand before the line from hip to ankle to tell the front."""


def handedness(
    positions: Float[np.ndarray, "moments points 3"],
    exists: Bool[np.ndarray, "moments points"],
    names: Sequence[str],
) -> Float[np.ndarray, " moments"]:
    """1 where the body's right is to the right of where it faces, -1 where to the left.

    The trunk has an up and a right, whose product points forwards; noses, toes and bent knees
    point forwards themselves. The value is the mean cosine between both; 0 where nothing tells.
    """
    points = {
        n: np.where(exists[:, k, None], positions[:, k], np.nan) for k, n in enumerate(names)
    }
    hips, shoulders = (_pair(points, name) for name in ("hip", "shoulder"))
    if hips is None or shoulders is None:
        return np.zeros(len(positions))
    up = _unit(shoulders[0] + shoulders[1] - hips[0] - hips[1])
    right = np.nan_to_num(_unit(hips[1] - hips[0])) + np.nan_to_num(
        _unit(shoulders[1] - shoulders[0])
    )
    forwards = _unit(np.cross(up, _unit(right)))
    cosines = [(_unit(_level(way, up)) * forwards).sum(-1) for way in _ahead(points)]
    if not cosines:
        return np.zeros(len(positions))
    known = np.isfinite(cosines)
    return np.nan_to_num(cosines).sum(0) / np.maximum(known.sum(0), 1)


def _ahead(points: dict[str, np.ndarray]) -> Iterator[np.ndarray]:
    """Ways that lead forwards whichever side they are on; NaN where they are too short to tell."""
    ears = _pair(points, "ear") or _pair(points, "shoulder")
    if "nose" in points and ears is not None:
        yield _long(points["nose"] - (ears[0] + ears[1]) / 2, _LEAST)
    for side in ("left", "right"):
        back = [points[f"{side}_{n}"] for n in _ANKLES if f"{side}_{n}" in points]
        front = [points[f"{side}_{n}"] for n in _TOES if f"{side}_{n}" in points]
        if back and front:
            yield _long(front[0] - back[0], _LEAST)
        leg = [points.get(f"{side}_{name}") for name in ("hip", "knee", "ankle")]
        if all(point is not None for point in leg):
            hip, knee, ankle = leg
            yield _long(knee - (hip + ankle) / 2, _BENT)  # type: ignore[operator]


def _pair(points: dict[str, np.ndarray], name: str) -> tuple[np.ndarray, np.ndarray] | None:
    left, right = points.get(f"left_{name}"), points.get(f"right_{name}")
    return None if left is None or right is None else (left, right)


def _long(way: np.ndarray, least: float) -> np.ndarray:
    return np.where(np.linalg.norm(way, axis=-1, keepdims=True) > least, way, np.nan)


def _level(way: np.ndarray, up: np.ndarray) -> np.ndarray:
    return way - (way * up).sum(-1, keepdims=True) * up


def _unit(way: np.ndarray) -> np.ndarray:
    return way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
