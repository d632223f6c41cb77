"""Rays of several cameras through keypoints: where they meet, and by how much they miss."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import Finding
from recon.diagnosis.views.images import Images

_LEAST_ANGLE = 0.03
"""Radians between rays below which the depth of their meeting point is mostly noise."""


@dataclass(frozen=True)
class Rays:
    """A line in the recording's frame for every keypoint of every view."""

    origin: Float[np.ndarray, "views moments 1 3"]
    direction: Float[np.ndarray, "views moments points 3"]
    """Unit length."""
    weight: Float[np.ndarray, "views moments points"]
    """Squared confidence; 0 where not seen."""

    @classmethod
    def of(cls, images: Images) -> "Rays":
        """The rays of all keypoints."""
        turn = images.pose[..., :3, :3]
        origin = -(images.pose[..., None, :3, 3] @ turn)
        return cls(origin, in_front(images) @ turn, images.confidence**2)

    def meet(
        self,
    ) -> tuple[Float[np.ndarray, "moments points 3"], Bool[np.ndarray, "moments points"]]:
        """The points nearest to their rays, and which exist: those that two views tell apart.

        The least Σ w |(I - d dᵀ)(x - o)|² over the views: a symmetric 3 x 3 system per point.
        """
        w, d = self.weight[..., None], self.direction
        matrix = np.einsum("vtp,ij->tpij", self.weight, np.eye(3))
        matrix -= np.einsum("vtpi,vtpj->tpij", w * d, d)
        along = (self.origin * d).sum(-1, keepdims=True)
        vector = (w * (self.origin - along * d)).sum(0)
        seen = self.weight > 0
        count = seen.sum(0)
        narrow = np.linalg.norm((seen[..., None] * d).sum(0), axis=-1) / np.maximum(count, 1)
        exists = (count >= 2) & (2 * (1 - narrow) > (_LEAST_ANGLE / 2) ** 2)
        return np.where(exists[..., None], solve_symmetric(matrix, vector, exists), 0.0), exists

    def miss(
        self, points: Float[np.ndarray, "moments points 3"]
    ) -> Float[np.ndarray, "views moments points"]:
        """Distance of points from the rays, metres."""
        away = points - self.origin
        along = (away * self.direction).sum(-1, keepdims=True)
        return np.linalg.norm(away - along * self.direction, axis=-1)


def in_front(images: Images) -> Float[np.ndarray, "views moments points 3"]:
    """Directions of keypoints in the frames of their cameras, unit length."""
    offset = images.pixels - images.matrix[:, None, None, :2, 2]
    inverse = np.linalg.inv(images.matrix[:, :2, :2])
    plane = offset @ np.swapaxes(inverse, -1, -2)[:, None]
    rays = np.concatenate((plane, np.ones_like(plane[..., :1])), -1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def solve_symmetric(
    matrix: Float[np.ndarray, "moments points 3 3"],
    vector: Float[np.ndarray, "moments points 3"],
    where: Bool[np.ndarray, "moments points"],
) -> Float[np.ndarray, "moments points 3"]:
    """Solutions of A x = b by cofactors, quicker than a general solver; zero elsewhere."""
    a, b, c = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2]
    d, e, f = matrix[..., 1, 1], matrix[..., 1, 2], matrix[..., 2, 2]
    rows = (
        (d * f - e * e, c * e - b * f, b * e - c * d),
        (c * e - b * f, a * f - c * c, b * c - a * e),
        (b * e - c * d, b * c - a * e, a * d - b * b),
    )
    determinant = a * rows[0][0] + b * rows[0][1] + c * rows[0][2]
    safe = np.where(where & (np.abs(determinant) > 1e-12), determinant, np.inf)
    x = [sum(row[k] * vector[..., k] for k in range(3)) / safe for row in rows]
    return np.stack(x, -1)


_BONES = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
    ("shoulder", "hip"),
)  # fmt: skip
_MIN_SIZE_RATIO, _MAX_SIZE_RATIO = 0.7, 1.17
"""Sizes against the average body, of 1.70 m: a child of 1.20 m, an adult of 2.00 m."""
_MIN_MOMENTS = 10
"""Moments at which a bone must be seen for its length to count."""


def body_size(images: Images) -> float | None:
    """Size of the triangulated body against the average one; None where too little is seen."""
    points, exists = Rays.of(images).meet()
    ratios = [
        float(np.median(length[both]) / np.linalg.norm(images.rest[a] - images.rest[b]))
        for a, b in _ends(images)
        for length, both in [_length(points, exists, a, b)]
        if both.sum() >= _MIN_MOMENTS
    ]
    return float(np.median(ratios)) if len(ratios) >= 4 else None


def scale_findings(images: Images) -> tuple[Finding, ...]:
    """Whether everything is larger or smaller than people are."""
    size = body_size(images) if len(images.names) > 1 else None
    if size is None or _MIN_SIZE_RATIO < size < _MAX_SIZE_RATIO:
        return ()
    return (
        Finding(
            "scale",
            f"the cameras see a person {size:.2f} times as large as the average one: their "
            "positions seem to be in another unit, or the pattern of the calibration to have "
            "another size than was given (--camera-unit; a person of "
            f"{1.7 * size:.2f} m is right as it is)",
            value=size,
        ),
    )


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
