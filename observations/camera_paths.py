"""The unknown scale of a moving camera's path, found from feet that stand still.

A person's distance follows from the size of the body, so feet have places in metres about the
camera. In the world they are where the camera is, in an unknown unit, plus that. One foot stands
at most moments, so the right unit is the one in which the slower foot hardly moves.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.keypoints2d import Keypoints2D
from observations.start.images import bone_distance
from observations.start.rigid import rigid_start, with_limbs_towards_points
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion

_LAG = 0.13
"""Seconds over which velocities are taken."""
_STANDING = 0.1
"""Metres per second by which standing feet seem to move."""
_FEET = ("left_ankle", "right_ankle")
_TRIED = np.geomspace(0.01, 30.0, 120)
"""Extents of the camera's path over the distance of the person that are tried."""
_CLOSER = np.geomspace(0.95, 1.05, 41)
_MIN_EXTENT = 1e-6
"""Extent of a path, in its own unit, below which the camera only turns, and no unit matters."""


def with_path_in_metres(
    view: Keypoints2D, feet: Float[np.ndarray, "batch moments feet 3"]
) -> Keypoints2D:
    """Scale the path of a view's camera to metres, so that feet mostly stand still.

    Its first pose stays.

    Args:
        view: of a camera that moves.
        feet: places in the frame of the camera, metres; nan where they are not known.
    """
    poses = view.camera.T_world_camera.double().cpu().numpy()
    units = [metres_per_path_unit(T, at, view.fps) for T, at in zip(poses, feet, strict=True)]
    return with_scaled_path(view, torch.tensor(units))


def with_scaled_path(view: Keypoints2D, scale: Float[Tensor, " batch"]) -> Keypoints2D:
    """Scale the path of a view's moving camera by a factor about its first position."""
    T = view.camera.T_world_camera.clone()
    first = T[:, :1, :3, 3]
    T[..., :3, 3] = first + scale.to(T)[:, None, None] * (T[..., :3, 3] - first)
    inverse = view.camera.derived(T_camera_world=T).T_world_camera  # the property inverts `T`
    return view.derived(camera=view.camera.derived(T_camera_world=inverse))


def metres_per_path_unit(
    T_world_camera: Float[np.ndarray, "moments 4 4"],
    feet: Float[np.ndarray, "moments feet 3"],
    fps: float,
) -> float:
    """Metres per unit of a camera's path, with which one foot stands still most of the time.

    1 where the camera only turns.

    Args:
        T_world_camera: in the tracker's unit.
        feet: one place of either foot in the frame of the camera, metres; nan where not seen.
        fps: of both.
    """
    positions = T_world_camera[:, :3, 3]
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    lag = max(1, round(_LAG * fps))
    seen = np.isfinite(feet).all(-1)
    distance = float(np.median(np.linalg.norm(feet[seen], axis=-1))) if seen.any() else np.nan
    if extent < _MIN_EXTENT or len(positions) <= lag or not np.isfinite(distance):
        return 1.0
    turned = np.einsum("tij,tfj->tfi", T_world_camera[:, :3, :3], feet)
    own = (turned[lag:] - turned[:-lag]) * fps / lag
    carried = (positions[lag:] - positions[:-lag])[:, None] * fps / lag
    if not np.isfinite(own).all(-1).any():
        return 1.0

    def mean_log_speed_of_slower_foot(unit: float) -> float:
        speed = np.linalg.norm(own + unit * carried, axis=-1)
        slower = np.nan_to_num(speed, nan=np.inf).min(-1)
        slower = slower[np.isfinite(slower)]
        return float(np.log1p((slower / _STANDING) ** 2).mean())

    tried = _TRIED * distance / extent
    best = tried[np.argmin([mean_log_speed_of_slower_foot(unit) for unit in tried])]
    closer = _CLOSER * best
    return float(closer[np.argmin([mean_log_speed_of_slower_foot(unit) for unit in closer])])


def feet_in_camera(
    view: Keypoints2D, body: BodyModel
) -> Float[np.ndarray, "batch moments feet 3"]:
    """Feet in the camera's frame, metres, at the distance that the length of bones implies."""
    names = list(view.points.names)
    rows = [names.index(name) for name in _FEET if name in names] or list(range(len(names)))
    rest = view.points.at_rest(body, body.template.new_zeros(body.shape_size)).to(view.pixels)
    distance = bone_distance(view.points, rest, view.pixels, view.confidence, view.camera)
    away = distance[..., None].expand(*distance.shape, len(rows))
    eye = view.camera.derived(
        T_camera_world=torch.eye(4).to(view.pixels).expand(*distance.shape[:1], 1, 4, 4)
    )
    feet = eye.unproject(view.pixels[..., rows, :], away)
    seen = view.confidence[..., rows] > 0
    return feet.where(seen[..., None], torch.nan).double().cpu().numpy()


_LEAST_ANGLE = 0.03
"""Radians between the rays that meet in a point; below it, depth is mostly noise."""


def triangulate(
    views: Sequence[Keypoints2D],
) -> tuple[Float[Tensor, "batch moments points 3"], Bool[Tensor, "batch moments points"]]:
    """Triangulate keypoints of several views; return positions, metres, and a mask.

    The point with least Σ c² |(I - d dᵀ)(x - o)|² over rays from o along the unit vector d: three
    linear equations per point, any number of views at once (OpenCV's triangulation takes two).
    A point exists where two views see it from directions that differ.

    Raises:
        ValueError: when the views do not share clock and layout.
    """
    clocks = {_clock(view) for view in views}
    if len(clocks) != 1:
        raise ObservationError(
            "views are triangulated moment by moment: expected one layout, frame rate, start time "
            "and number of moments for all (cut or resample), got "
            + " and ".join(f"{fps:g} fps from {t:g} s, {tuple(n)}" for fps, t, *n in clocks)
        )
    matrix = views[0].pixels.new_zeros(*views[0].confidence.shape, 3, 3)
    vector = views[0].pixels.new_zeros(*views[0].confidence.shape, 3)
    spread, count = torch.zeros_like(vector), torch.zeros_like(views[0].confidence)
    for view in views:
        far = view.camera.unproject(view.pixels, torch.ones_like(view.confidence))
        origin = view.camera.T_world_camera[..., None, :3, 3]
        ray = torch.nn.functional.normalize(far - origin, dim=-1)
        across = torch.eye(3).to(ray) - ray[..., :, None] * ray[..., None, :]
        across = view.confidence.square()[..., None, None] * across
        matrix = matrix + across
        vector = vector + (across @ origin[..., None])[..., 0]
        seen = (view.confidence > 0).to(ray)
        spread, count = spread + seen[..., None] * ray, count + seen
    # unit rays at small angles a (radians) to their mean direction have a mean of length 1 - a²/2
    narrow = (spread.norm(dim=-1) / count.clamp(min=1)).clamp(max=1)
    exists = (count >= 2) & (2 * (1 - narrow) > (_LEAST_ANGLE / 2) ** 2)
    solvable = torch.where(exists[..., None, None], matrix, torch.eye(3).to(matrix)).double()
    points = torch.linalg.solve(solvable, vector.double()[..., None])[..., 0].to(vector)
    return torch.where(exists[..., None], points, 0.0), exists


def views_to_triangulate(views: Sequence[Keypoints2D]) -> list[Keypoints2D]:
    """Return the views with the first one's clock and layout; none if they tell no distance.

    In every clip, rays of some point must differ enough in direction to triangulate it. Cameras
    side by side see hardly more than one of them does: not how far a person is.
    """
    alike = [view for view in views if _clock(view) == _clock(views[0])]
    _, exists = triangulate(alike)
    return alike if bool(exists.any(-1).any(-1).all()) else []


def _clock(view: Keypoints2D) -> tuple[Any, ...]:
    """Frame rate, start time, and numbers of clips, frames and points."""
    return (view.fps, view.start_time, *view.pixels.shape[:-1])


def guess_from_views(body: BodyModel, views: Sequence[Keypoints2D]) -> Motion:
    """First guess from several views: rest body at the triangulated torso, limbs turned."""
    first = views[0]
    positions, visible = triangulate(views)
    rest, bones = first.at_rest(body).to(positions), first.bones(body)
    start = rigid_start(
        body, rest, bones, positions, visible, fps=first.fps, start_time=first.start_time
    )
    return with_limbs_towards_points(start, body, rest, bones, positions, visible)
