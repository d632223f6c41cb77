"""Pinhole cameras with OpenCV's lens distortion: world points to pixels and back."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core import limits
from recon.core import rotations as so3
from recon.core.arrays import Numbers, float_tensor, index_tuple, require_shape
from recon.core.errors import ReconError
from recon.core.rotations import transform as transform
from recon.core.struct import TensorStruct

NEAREST = 0.01
"""Points closer to the image plane than this, or behind it, are not seen; metres."""

COEFFICIENT_COUNTS = (4, 5, 8)
"""OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]."""

_UNDISTORT_STEPS = 30


@dataclass(frozen=True)
class Projection(TensorStruct):
    """Pixel coordinates and depths of projected points; finite even behind the camera."""

    pixels: Float[Tensor, "*batch points 2"]
    """u to the right, v down. Meaningless, and without gradient, where not `in_front`."""
    depth: Float[Tensor, "*batch points"]
    """Distance along the viewing axis, metres."""

    @property
    def in_front(self) -> Bool[Tensor, "*batch points"]:
        """Mask of points in front of the camera; they may still lie outside the image."""
        return self.depth > NEAREST


@dataclass(frozen=True)
class Camera(TensorStruct):
    """A calibrated camera, fixed or moving; its axes are x right, y down, z forward (OpenCV).

    The leading axes of the three tensors broadcast against those of the points: none for a fixed
    camera, (time,) for a moving one, (batch, time or 1) for a batch of clips.
    """

    camera_matrix: Float[Tensor, "*#frames 3 3"]
    """Focal lengths, skew and principal point, pixels."""
    image_size: tuple[int, int]
    """Width and height, pixels."""
    distortion: Float[Tensor, "*#frames coefficients"] | None
    """k1 k2 p1 p2 [k3 [k4 k5 k6]] in OpenCV's order, or None for a perfect lens."""
    T_camera_world: Float[Tensor, "*#frames 4 4"]
    """Maps world points to the camera frame, metres."""

    def __post_init__(self) -> None:
        focal = self.camera_matrix[..., [0, 1], [0, 1]]
        if not bool((focal > 0).all()):
            raise ReconError(
                f"focal lengths must be positive pixels, got {focal.tolist()}; "
                "expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            )
        if len(self.image_size) != 2 or min(self.image_size) <= 0:
            raise ReconError(f"image size must be positive (width, height), got {self.image_size}")
        lens = self.distortion
        if lens is not None and lens.shape[-1] not in COEFFICIENT_COUNTS:
            raise ReconError(
                f"expected {' or '.join(map(str, COEFFICIENT_COUNTS))} distortion coefficients "
                f"(k1 k2 p1 p2 [k3 [k4 k5 k6]]), got {lens.shape[-1]}"
            )
        check_pose(self.T_camera_world.detach().cpu(), "Camera", "T_camera_world")
        lenses = [None] if self.distortion is None else self._unique_rows(self.distortion)
        for matrix in self._unique_rows(self.camera_matrix.flatten(-2)):
            for lens in lenses:
                check_camera(matrix.reshape(3, 3), self.image_size, lens, "Camera")

    @staticmethod
    def _unique_rows(rows: Tensor) -> list[Tensor]:
        """Unique rows of intrinsics; usually one, as lenses rarely change during a clip."""
        return list(rows.detach().cpu().double().reshape(-1, rows.shape[-1]).unique(dim=0))

    @classmethod
    def create(
        cls,
        camera_matrix: Numbers,
        image_size: tuple[int, int],
        distortion: Numbers | None = None,
        T_camera_world: Numbers | None = None,
    ) -> "Camera":
        """Make a camera from arrays; without a pose, camera and world coordinates coincide.

        Arrays of numpy become tensors in single precision.

        Raises:
            ValueError: naming the array, what was expected and what came.
        """
        matrix = float_tensor(camera_matrix, "Camera.camera_matrix")
        require_shape(matrix, "Camera.camera_matrix", (3, 3))
        size = index_tuple(image_size, "Camera.image_size")
        lens = None if distortion is None else float_tensor(distortion, "Camera.distortion")
        if lens is not None:
            require_shape(lens, "Camera.distortion", ("coefficients",))
        pose = float_tensor(
            np.eye(4) if T_camera_world is None else T_camera_world, "Camera.T_camera_world"
        )
        require_shape(pose, "Camera.T_camera_world", (4, 4))
        lens = None if lens is None else lens.to(matrix)
        return cls(matrix, cast(tuple[int, int], size), lens, pose.to(matrix))

    @property
    def T_world_camera(self) -> Float[Tensor, "*#frames 4 4"]:
        """Transform from camera to world coordinates, the inverse of `T_camera_world`."""
        turn = self.T_camera_world[..., :3, :3].mT
        place = -turn @ self.T_camera_world[..., :3, 3:]
        return torch.cat((torch.cat((turn, place), -1), self.T_camera_world[..., 3:, :]), -2)

    def at(self, moments: range) -> "Camera":
        """Return the camera with the poses of the given frames; beyond the ends, with the nearest.

        Its poses must have an axis of frames, of length one for a fixed camera.
        """
        poses = self.T_camera_world
        if poses.shape[-3] == 1:
            return self
        nearest = torch.tensor(moments, device=poses.device).clamp(0, poses.shape[-3] - 1)
        return self.derived(T_camera_world=poses[..., nearest, :, :])

    def to_camera(
        self, points: Float[Tensor, "*batch points 3"]
    ) -> Float[Tensor, "*all points 3"]:
        """Transform points from world to camera coordinates, metres."""
        return transform(self.T_camera_world, points)

    def to_world(self, points: Float[Tensor, "*batch points 3"]) -> Float[Tensor, "*all points 3"]:
        """Transform points from camera to world coordinates, metres."""
        return transform(self.T_world_camera, points)

    def project(self, points: Float[Tensor, "*batch points 3"]) -> Projection:
        """Pixels and depths of world points; differentiable, finite behind the camera too."""
        seen = self.to_camera(points)
        depth = seen[..., 2]
        in_front = (depth > NEAREST)[..., None]
        # selecting before the division keeps gradients of unseen points finite (zero)
        plane = torch.where(in_front, seen[..., :2], 0.0)
        rays = plane / torch.where(in_front, depth[..., None], 1.0)
        if self.distortion is not None:
            radial, shift = _distortion_terms(rays, self.distortion[..., None, :])
            rays = rays * radial + shift
        pixels = rays @ self.camera_matrix[..., :2, :2].mT + self.camera_matrix[..., None, :2, 2]
        return Projection(pixels, depth)

    def unproject(
        self, pixels: Float[Tensor, "*batch points 2"], depth: Float[Tensor, "*batch points"]
    ) -> Float[Tensor, "*all points 3"]:
        """Return the world points at given pixels and depths (metres along the viewing axis)."""
        centred = (pixels - self.camera_matrix[..., None, :2, 2]).mT
        rays = torch.linalg.solve(self.camera_matrix[..., :2, :2], centred).mT
        if self.distortion is not None:
            rays = _undistort(rays, self.distortion[..., None, :])
        rays = torch.cat((rays, torch.ones_like(rays[..., :1])), -1)
        return self.to_world(rays * depth[..., None])

    def in_image(self, pixels: Float[Tensor, "*batch points 2"]) -> Bool[Tensor, "*batch points"]:
        """Mask of the pixels that lie inside the image."""
        size = pixels.new_tensor(self.image_size)
        return ((pixels >= 0) & (pixels < size)).all(-1)

    def moved(self, T_new_old: Float[np.ndarray, "4 4"]) -> "Camera":
        """Return this camera for other world coordinates; `T_new_old` maps old ones to new."""
        poses = self.T_camera_world
        back = torch.from_numpy(np.linalg.inv(T_new_old)).to(poses)
        return self.derived(T_camera_world=poses @ back)

    def placed(self, position: Float[Tensor, "3"], target: Float[Tensor, "3"]) -> "Camera":
        """Return this camera at a fixed position of the world (z up), looking at a target.

        Raises:
            ValueError: when it would look straight up or down.
        """
        return self.replace(T_camera_world=pose_looking_at(position, target))


def check_camera(matrix: Any, size: Any, distortion: Any, source: object, key: str = "") -> None:
    """Refuse intrinsics that no real camera has.

    Args:
        matrix: (3, 3), pixels.
        size: width and height, pixels.
        distortion: k1 k2 p1 p2 [k3 [k4 k5 k6]] or None.
        source: the file, for the message.
        key: the camera's name, for the message.

    Raises:
        ValueError: naming file, quantity and what came.
    """
    K, longer = np.asarray(matrix, np.float64), float(max(size))
    limits.IMAGE_SIZE.check(size, source, f"{key} image_size".strip())
    place = f"{key} camera_matrix".strip()
    if np.abs(K[[1, 2, 2], [0, 0, 1]]).max() > 1e-6 or abs(K[2, 2] - 1) > 1e-6:
        raise ReconError(
            f"{source}: expected a camera matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]] at "
            f"{place}, got {K.tolist()}"
        )
    focal = np.diag(K)[:2]
    limits.FOCAL_LENGTH.check(focal, source, place)
    limits.FIELD.check(focal / longer, source, place)
    limits.PIXEL_ASPECT.check(focal[0] / focal[1], source, place)
    limits.PRINCIPAL_POINT.check(K[:2, 2] / longer, source, place)
    limits.SKEW.check(K[0, 1] / focal[0], source, place)
    if distortion is not None:
        place = f"{key} distortion".strip()
        limits.DISTORTION.check(distortion, source, place)
        k = np.pad(np.asarray(distortion, np.float64), (0, 8))[:8]
        r2 = (min(size) / 4 / float(focal.max())) ** 2
        over = 1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3
        limits.LENS.check(over / (1 + k[5] * r2 + k[6] * r2**2 + k[7] * r2**3), source, place)


def check_pose(pose: Any, source: object, key: str) -> None:
    """Refuse transforms (..., 4, 4) that are not rigid or have an implausibly large translation.

    Raises:
        ValueError: naming file, quantity and what came.
    """
    T = np.asarray(pose, np.float64)
    rotation = T[..., :3, :3]
    # numbers near the largest double may overflow here; the limit refuses infinity
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max((-1, -2))
        limits.ORTHOGONALITY.check(off, source, key)
        mirrored = np.linalg.det(rotation) < 0
        bottom = np.abs(T[..., 3, :] - (0.0, 0.0, 0.0, 1.0)).max()
    if mirrored.any() or not bottom < 1e-6:
        raise ReconError(
            f"{source}: expected rigid transforms in {key} with a last row 0 0 0 1, got a "
            "reflection or another last row"
        )
    limits.POSITION.check(T[..., :3, 3], source, key)


def pose_looking_at(
    position: Float[Tensor, "3"], target: Float[Tensor, "3"]
) -> Float[Tensor, "4 4"]:
    """T_camera_world of an upright camera at `position` whose viewing axis meets `target`.

    Raises:
        ValueError: when the viewing axis is vertical, which leaves the image's up undefined.
    """
    forward = torch.nn.functional.normalize(target - position, dim=0)
    right = torch.linalg.cross(forward, forward.new_tensor([0.0, 0.0, 1.0]))
    if not right.norm() > 1e-6:
        raise ReconError(
            f"a camera at {position.tolist()} must not look straight up or down, as it does at "
            f"{target.tolist()}; move the camera or the target sideways"
        )
    right = right / right.norm()
    turn = torch.stack((right, torch.linalg.cross(forward, right), forward))
    pose = torch.eye(4, dtype=position.dtype, device=position.device)
    pose[:3, :3], pose[:3, 3] = turn, -turn @ position
    return pose


def _undistort(
    rays: Float[Tensor, "*shape 2"], coefficients: Float[Tensor, "*#shape coefficients"]
) -> Float[Tensor, "*shape 2"]:
    """Remove lens distortion from coordinates x/z, y/z, by fixed-point iteration."""
    straight = rays
    for _ in range(_UNDISTORT_STEPS):
        radial, shift = _distortion_terms(straight, coefficients)
        straight = (rays - shift) / radial
    return straight


def _distortion_terms(rays: Tensor, coefficients: Tensor) -> tuple[Tensor, Tensor]:
    """Return radial factor and tangential shift of OpenCV's lens model at x/z, y/z."""
    missing = COEFFICIENT_COUNTS[-1] - coefficients.shape[-1]
    padded = torch.nn.functional.pad(coefficients, (0, missing))[..., None]
    k1, k2, p1, p2, k3, k4, k5, k6 = padded.unbind(-2)
    x, y = rays[..., :1], rays[..., 1:]
    r2 = x.square() + y.square()
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    shift_x = 2 * p1 * x * y + p2 * (r2 + 2 * x.square())
    shift_y = p1 * (r2 + 2 * y.square()) + 2 * p2 * x * y
    return radial, torch.cat((shift_x, shift_y), -1)


def _centred_camera(focal: float, width: int, height: int) -> Camera:
    rows = [[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]
    return Camera.create(torch.tensor(rows), (width, height))


def full_hd_camera() -> Camera:
    """Return a typical phone camera at the origin: 1920 x 1080 pixels, 65 degrees wide."""
    return _centred_camera(1500.0, 1920, 1080)


def depth_camera() -> Camera:
    """Return a typical depth camera at the origin: 512 x 424 pixels, 70 degrees wide."""
    return _centred_camera(365.0, 512, 424)


_UPRIGHT = 1e-6
"""Squared sine of the angle between a direction and the normal below which it has no heading."""


@dataclass(frozen=True)
class Ground(TensorStruct):
    """The plane n·x = d with unit normal n pointing up, in whatever frame the normal is given.

    Normal and offset are kept apart: n·d, one vector for both, is singular at d = 0.
    """

    normal: Float[Tensor, "*batch 3"]
    offset: Float[Tensor, "*batch"]
    """d, metres."""

    @classmethod
    def create(
        cls, normal: Float[Tensor, "*batch 3"], offset: Float[Tensor, "*batch"]
    ) -> "Ground":
        """The plane n·x = d from a normal of any length; d is in units of that length.

        Raises:
            ValueError: when a normal is zero.
        """
        length = normal.norm(dim=-1)
        if not bool((length > 0).all()):
            raise ReconError(f"a ground needs a normal that is not zero, got {normal.tolist()}")
        return cls(normal / length[..., None], offset / length)

    @classmethod
    def seen_from(cls, T_camera_world: Float[Tensor, "*batch 4 4"]) -> "Ground":
        """Return the world's ground z = 0 as a plane in the coordinates of a posed camera."""
        normal = T_camera_world[..., :3, 2]
        return cls(normal, (normal * T_camera_world[..., :3, 3]).sum(-1))

    @property
    def coefficients(self) -> Float[Tensor, "*batch 4"]:
        """The plane's coefficients (nx, ny, nz, d) of n·x = d, as in files."""
        return torch.cat((self.normal, self.offset[..., None]), -1)

    def heights(self, points: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape"]:
        """Signed distance n·p - d of points above the ground, metres.

        The ground's axes are the leading ones of the points, as (batch) of (batch time joints).
        """
        inner = (1,) * (points.dim() - self.normal.dim())
        normal = self.normal.unflatten(-1, (*inner, 3))
        return (points * normal).sum(-1) - self.offset[(..., *(None for _ in inner))]


def tangent_basis(normal: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 2"]:
    """Two orthonormal columns perpendicular to a unit normal (Duff et al. 2017, no branch)."""
    x, y, z = normal.unbind(-1)
    sign = torch.where(z >= 0, 1.0, -1.0).to(normal)
    a = -1 / (sign + z)
    b = x * y * a
    first = torch.stack((1 + sign * x.square() * a, sign * b, -sign * x), -1)
    second = torch.stack((b, sign + y.square() * a, -y), -1)
    return torch.stack((first, second), -1)


def rotation_to_heading_frame(
    ground: Ground, root: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch 3 3"]:
    """Rotation into the frame whose z is the ground's normal and whose y is the body's forward.

    Its rows are right, forward and up with right = r - (r·n) n, normalised, for the body's right
    r = -root[:, 0], up = n and forward = cross(n, right). The closed form has no singularity
    where r is parallel to the ground, as HuMoR's intersection of a ray with the plane has. Where
    r is vertical (a body lying on its side) the heading is that of the body's front, root[:, 2].
    """
    up = ground.normal
    side, front = -root[..., :, 0], root[..., :, 2]
    along = side - (side * up).sum(-1, keepdim=True) * up
    # if a body lies on its side, `side` is vertical, and a horizontal `front` is used instead
    spare = torch.linalg.cross(front, up, dim=-1)
    defined = along.square().sum(-1, keepdim=True) > _UPRIGHT
    right = torch.nn.functional.normalize(torch.where(defined, along, spare), dim=-1)
    return torch.stack((right, torch.linalg.cross(up, right, dim=-1), up), -2)


def world_from_camera(
    ground: Ground, root: Float[Tensor, "*batch 3 3"], origin: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 4 4"]:
    """T_world_camera of a camera of unknown pose, from the ground and the body that it sees.

    The world's z = 0 is the ground, its y the body's forward direction in the first frame, and
    `origin` (a point such as the first pelvis, camera frame, metres) lies above its origin. All
    of it follows from values a fit moves, so gradients reach the ground through it.
    """
    rotation = rotation_to_heading_frame(ground, root)
    turned = (rotation @ origin[..., None])[..., 0]
    shift = torch.cat((-turned[..., :2], -ground.offset[..., None]), -1)
    return so3.rigid(rotation, shift)
