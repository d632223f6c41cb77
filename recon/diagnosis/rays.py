"""Rays of several cameras through keypoints, and trajectories of the triangulated points."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import Finding
from recon.diagnosis.images import Images

_MIN_ANGLE_RAD = 0.03
"""Angle (rad) between rays below which the depth of their meeting point is mostly noise."""


@dataclass(frozen=True)
class Rays:
    """Rays from camera centres through keypoints, in the recording's frame (m)."""

    origin: Float[np.ndarray, "views moments 1 3"]
    direction: Float[np.ndarray, "views moments points 3"]
    """Unit vectors."""
    weight: Float[np.ndarray, "views moments points"]
    """Squared confidence; 0 where not seen."""

    @classmethod
    def of(cls, images: Images) -> "Rays":
        """Compute the rays of all keypoints from camera matrices and poses."""
        turn = images.pose[..., :3, :3]
        origin = -(images.pose[..., None, :3, 3] @ turn)
        return cls(origin, ray_directions(images) @ turn, images.confidence**2)

    def triangulated(
        self,
    ) -> tuple[Float[np.ndarray, "moments points 3"], Bool[np.ndarray, "moments points"]]:
        """Triangulate points (m); also mask those that two views see under a sufficient angle.

        The minimum of Σ w |(I - d dᵀ)(x - o)|² over the views: a symmetric 3 x 3 system per point.
        """
        w, d = self.weight[..., None], self.direction
        matrix = np.einsum("vtp,ij->tpij", self.weight, np.eye(3))
        matrix -= np.einsum("vtpi,vtpj->tpij", w * d, d)
        along = (self.origin * d).sum(-1, keepdims=True)
        vector = (w * (self.origin - along * d)).sum(0)
        seen = self.weight > 0
        count = seen.sum(0)
        narrow = np.linalg.norm((seen[..., None] * d).sum(0), axis=-1) / np.maximum(count, 1)
        exists = (count >= 2) & (2 * (1 - narrow) > (_MIN_ANGLE_RAD / 2) ** 2)
        matrix[~exists], vector[~exists] = np.eye(3), 0.0
        return np.linalg.solve(matrix, vector[..., None])[..., 0], exists

    def distances_from(
        self, points: Float[np.ndarray, "moments points 3"]
    ) -> Float[np.ndarray, "views moments points"]:
        """Return distances (m) of points from the rays."""
        away = points - self.origin
        along = (away * self.direction).sum(-1, keepdims=True)
        return np.linalg.norm(away - along * self.direction, axis=-1)


def ray_directions(images: Images) -> Float[np.ndarray, "views moments points 3"]:
    """Return unit vectors to keypoints in the frames of their cameras."""
    offset = images.pixels - images.matrix[:, None, None, :2, 2]
    inverse = np.linalg.inv(images.matrix[:, :2, :2])
    plane = offset @ np.swapaxes(inverse, -1, -2)[:, None]
    rays = np.concatenate((plane, np.ones_like(plane[..., :1])), -1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


_BONES = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
    ("shoulder", "hip"),
)  # fmt: skip
_MIN_SIZE_RATIO, _MAX_SIZE_RATIO = 0.7, 1.17
"""Plausible sizes relative to the average body of 1.70 m: a child of 1.20 m, an adult of 2.00
m."""
_MIN_FRAMES = 10
"""Number of frames in which a bone must be seen for its length to count."""


def body_size(images: Images) -> float | None:
    """Return the triangulated body's size relative to the average; None if too little is seen."""
    points, exists = Rays.of(images).triangulated()
    ratios: list[float] = []
    for side, bone in product(("left", "right"), _BONES):
        if {*(names := [f"{side}_{part}" for part in bone])} <= {*images.points}:
            a, b = map(images.points.index, names)
            both = exists[:, a] & exists[:, b]
            length = np.linalg.norm(points[both, a] - points[both, b], axis=-1)
            if len(length) >= _MIN_FRAMES:
                rest = np.linalg.norm(images.rest[a] - images.rest[b])
                ratios.append(float(np.median(length) / rest))
    return float(np.median(ratios)) if len(ratios) >= 4 else None


def scale_findings(images: Images) -> tuple[Finding, ...]:
    """Return a warning if the triangulated body is larger or smaller than people are."""
    size = body_size(images) if len(images.names) > 1 else None
    if size is None or _MIN_SIZE_RATIO < size < _MAX_SIZE_RATIO:
        return ()
    return (
        Finding(
            "scale",
            f"the cameras see a person {size:.2f} times as large as the average one: the cameras' "
            "positions seem to be in another unit, or the pattern of the calibration has another "
            f"size than was given (--camera-unit); if the person is {1.7 * size:.2f} m tall, "
            "nothing is wrong",
            value=size,
        ),
    )


_PARABOLA_S = 0.07
"""Time (s) before and after each frame over which a parabola is fitted to a point's path."""


@dataclass(frozen=True)
class Trajectories:
    """Triangulated points over time, smoothed by a parabola about every frame.

    In the middle of a least-squares parabola, errors of position and velocity are uncorrelated;
    elsewhere their correlation is known. So a time offset can be estimated without bias from the
    residuals of a view and the velocities of the points.
    """

    position: Float[np.ndarray, "moments points 3"]
    """Positions (m) in the recording's frame."""
    velocity: Float[np.ndarray, "moments points 3"]
    """Velocities in metres per frame."""
    acceleration: Float[np.ndarray, "moments points 3"]
    """Accelerations in metres per squared frame."""
    covariance: Float[np.ndarray, "moments points 3 3"]
    """Covariance of a position (m²), for white noise of the keypoints."""
    velocity_noise: float
    """Variance of a velocity over that of a position, 1 / squared frames."""
    exists: Bool[np.ndarray, "moments points"]
    """Whether the point was triangulated in all frames of its parabola."""
    disagreement: Float[np.ndarray, "moments points"]
    """Sum of the squared residuals of the keypoints, in standard deviations; 0 if not seen."""
    noise: float
    """Ratio of the keypoints' residuals to those of white noise, from their median."""

    @classmethod
    def of(cls, images: Images, noise: Float[np.ndarray, " views"]) -> "Trajectories":
        """Triangulate the points that at least two views see, and fit parabolas over time.

        Args:
            images: keypoints and cameras of the views.
            noise: standard deviation of a pixel coordinate in every view.
        """
        points, exists = Rays.of(images).triangulated()
        local, front = in_camera(images.pose, points[None])
        seen = images.seen & front & exists
        slope = derivatives_of_projection(local, front) * images.focal[:, None, None, None, None]
        slope = slope @ images.pose[:, :, None, :3, :3] / noise[:, None, None, None, None]
        slope = np.where(seen[..., None, None], slope, 0.0)
        information = np.einsum("vtpki,vtpkj->tpij", slope, slope) + 1e-6 * np.eye(3)
        away = images.pixels - projected(images, local, front)
        squared = np.square(away / noise[:, None, None, None]).sum(-1)
        squared = np.where(seen, squared, 0.0).sum(0)
        free = np.maximum(2 * seen.sum(0) - 3, 1)
        usual = free * (1 - 2 / (9 * free)) ** 3  # median of chi², Wilson and Hilferty 1931
        beyond = np.median((squared / usual)[exists]) if exists.any() else 0.0
        reach = max(1, min(round(_PARABOLA_S * images.fps), (len(points) - 1) // 2))
        design = np.arange(-reach, reach + 1)[:, None] ** np.arange(3)
        solve = np.linalg.pinv(design)
        whole = np.asarray(_sliding_windows(exists, reach).all(-1))
        parts = np.einsum("kw,tpiw->ktpi", solve, _sliding_windows(points, reach))
        parts = np.where(whole[..., None], parts, 0.0)
        spread, speed = np.square(solve[:2]).sum(-1).tolist()
        return cls(
            position=parts[0],
            velocity=parts[1],
            acceleration=2 * parts[2],
            covariance=spread * np.linalg.inv(information),
            velocity_noise=speed / spread,
            exists=whole,
            disagreement=squared,
            noise=float(np.sqrt(beyond)),
        )

    def at(
        self, frames: Float[np.ndarray, " moments"]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return positions, velocities, covariances and a mask at fractional frame numbers.

        The error of a position at t frames from the middle of its parabola is correlated with that
        of the velocity: their covariance is t times the variance of the velocity.
        """
        nearest = np.rint(frames).astype(int)
        inside = (nearest >= 0) & (nearest < len(self.position))
        row = np.clip(nearest, 0, len(self.position) - 1)
        past = (frames - nearest)[:, None, None]
        bend = self.acceleration[row]
        position = self.position[row] + past * self.velocity[row] + past**2 / 2 * bend
        return (
            position,
            self.velocity[row],
            self.covariance[row],
            self.exists[row] & inside[:, None],
        )


def in_camera(
    pose: Float[np.ndarray, "*poses 4 4"],
    points: Float[np.ndarray, "*_ points 3"],
) -> tuple[np.ndarray, np.ndarray]:
    """Transform points to a camera's frame (m); also return a mask of those in front of it."""
    local = points @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]
    return local, local[..., 2] > 0.05


def derivatives_of_projection(
    local: Float[np.ndarray, "*samples 3"], front: Bool[np.ndarray, "*samples"]
) -> Float[np.ndarray, "*samples 2 3"]:
    """Differentiate (x / z, y / z) by a point in the camera's frame; zero behind the camera."""
    z = np.where(front, local[..., 2], 1.0)
    zero = np.zeros_like(z)
    rows = (
        np.stack((1 / z, zero, -local[..., 0] / z**2), -1),
        np.stack((zero, 1 / z, -local[..., 1] / z**2), -1),
    )
    return np.where(front[..., None, None], np.stack(rows, -2), 0.0)


def derivatives_by_rotation(
    local: Float[np.ndarray, "*samples 3"],
) -> Float[np.ndarray, "*samples 3 3"]:
    """Differentiate points in a camera's frame by a rotation vector about its axes."""
    x, y, z = np.moveaxis(local, -1, 0)
    zero = np.zeros_like(x)
    rows = (zero, z, -y), (-z, zero, x), (y, -x, zero)
    return np.stack([np.stack(row, -1) for row in rows], -2)


def projected(
    images: Images,
    local: Float[np.ndarray, "views moments points 3"],
    front: Bool[np.ndarray, "views moments points"],
) -> Float[np.ndarray, "views moments points 2"]:
    """Project points in the frames of the cameras to pixels; meaningless behind the cameras."""
    plane = local[..., :2] / np.where(front, local[..., 2], 1.0)[..., None]
    turned = plane @ np.swapaxes(images.matrix[:, None, :2, :2], -1, -2)
    return turned + images.matrix[:, None, None, :2, 2]


def _sliding_windows(values: np.ndarray, half_width: int) -> np.ndarray:
    """Return sliding windows over time, in a new last axis, padded with zeros at both ends."""
    edges = ((half_width, half_width), *((0, 0),) * (values.ndim - 1))
    padded = np.pad(values, edges)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half_width + 1, axis=0)
