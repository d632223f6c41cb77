"""Makes point clouds an observation: turns z up, selects the person's points, thins them."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from observations.depth import PointCloud
from observations.surfels import Surfels
from recon.body.model import BodyModel
from recon.core.camera import Camera, Ground
from recon.core.errors import ObservationError
from recon.core.limits import FRAMES, PADDED_CLOUD
from recon.core.planes import (
    FoundGround,
    above_ground,
    cluster_numbers,
    depth_noise,
    find_ground,
    find_walls,
    in_front_of_plane,
    point_spacing,
)
from recon.formats.cameras import CameraArrays
from recon.formats.observations import PointsFile
from recon.reading.images import undistorted_camera
from recon.reading.moving_sensor import sensor_movement, sensor_position

_LARGE = 0.4
"""Share of the largest thing's points that another one has which may be the person."""
_MIN_SEPARATION_M = 0.5
"""Metres, along the ground, between the middles of things that are no parts of one person. An
occluder may divide a body in two, which stand above each other."""
_TALL = 1.0
"""Metres from corner to corner that a whole person measures at least, crouching; what is smaller
may be a limb that an occluder cuts off."""
_OFTEN = 0.1
"""Share of the frames with points in which something must stand beside to be worth a word."""


@dataclass(frozen=True)
class _PersonClusters:
    """The clusters of one frame that may be the person, the largest first."""

    label: Int[np.ndarray, " points"]
    middles: Float[np.ndarray, "things 3"]
    sizes: Float[np.ndarray, " things"]
    """Metres from corner to corner of the box around a thing."""
    second: float
    """Share of the largest one's points that the second has."""


def clusters_of_one_person(clouds: list[np.ndarray], reach: float) -> tuple[list[np.ndarray], int]:
    """Choose a cluster per frame: the largest in the clearest frame, from there on the nearest.

    The largest cluster of every frame would jump from one person to another.

    Args:
        clouds: points of every frame, z up, metres, without the ground; frames may be empty.
        reach: metres between neighbouring points of one cluster.

    Returns:
        The points of the cluster in every frame, and the number of frames in which another cluster
        of a person's size is seen; 0 for a few.
    """
    frames = {
        k: _clusters_of_frame(cloud, reach) for k, cloud in enumerate(clouds) if len(cloud) > 0
    }
    kept, beside = [cloud[:0] for cloud in clouds], 0
    if not frames:
        return kept, 0
    clearest = min(frames, key=lambda k: frames[k].second)
    shown = list(frames)
    ways = [k for k in shown if k >= clearest], [k for k in shown[::-1] if k < clearest]
    for way in ways:
        last = frames[clearest].middles[0]
        for k in way:
            one = frames[k]
            chosen = int(np.linalg.norm(one.middles - last, axis=-1).argmin())
            last = one.middles[chosen]
            kept[k] = clouds[k][one.label == chosen]
            away = np.linalg.norm((one.middles - last)[:, :2], axis=-1)
            beside += bool(((away > _MIN_SEPARATION_M) & (one.sizes > _TALL)).any())
    return kept, beside if beside > _OFTEN * len(frames) else 0


def _clusters_of_frame(cloud: Float[np.ndarray, "points 3"], reach: float) -> _PersonClusters:
    label = cluster_numbers(cloud, reach)
    size = np.bincount(label)
    large = int((size >= _LARGE * size[0]).sum())
    things = [cloud[label == k] for k in range(large)]
    return _PersonClusters(
        label,
        middles=np.stack([np.median(thing, axis=0) for thing in things]),
        sizes=np.array([np.linalg.norm(np.ptp(thing, axis=0)) for thing in things]),
        second=float(size[1] / size[0]) if len(size) > 1 else 0.0,
    )


POINTS = 512
"""Points fitted in a frame: the search for neighbours then takes a third of a fit's time."""
_UP_IN_CAMERA = (0.0, -1.0, 0.0)
_UP_IN_WORLD = (0.0, 0.0, 1.0)
_KNOWN_GROUND = 0.1
"""Metres by which a plane that is seen may miss z = 0 and still be the ground that is known."""
_BELOW = -0.2
"""Height of the lowest points of scans under which z = 0 cannot be the ground."""
_LEVEL = Ground.create(torch.tensor([0.0, 0.0, 1.0]).double(), torch.tensor(0.0).double())
_LEAST = 20
"""Points that make a frame worth having."""
_REACH, _SPACINGS = 0.08, 2.0
"""Steps that join points to one thing: metres, or where points are sparse so many times as far as
they are from each other."""
_FLAT = 0.1
"""Metres that a person rises above the ground at least, lying; noise of the ground rises less."""
_WIDE = 3.0
"""A cloud that is wider than this along the ground, in metres, cannot be one person alone."""
_SHOWN = 0.03
"""Share of the frames in which a person is in sight at least."""
_FEW = 0.25
"""Share of the usual points that flat things have where they are noise."""
_MUCH = 0.1
"""Share of the points above which other things than the largest are furniture, not noise."""
_LOOKED_AT = 50
"""Frames that tell how sparse points are."""


@dataclass(frozen=True)
class LoadedCloud:
    """A cloud of one person as an observation, and notes on how it was read."""

    cloud: PointCloud
    """Axes (1, moments, points)."""
    ground: FoundGround
    """The plane seen in the frame of the file, or why there is none."""
    T_recording_file: Float[np.ndarray, "4 4"]
    """Maps points of the file to the frame of the recording (z up), metres."""
    decisions: tuple[str, ...] = ()
    """What was left out besides the ground, and whether the sensor seems to move, in words."""


def cloud_of(
    file: PointsFile,
    body: BodyModel,
    *,
    points: int = POINTS,
    seed: int = 0,
    T_recording_camera: Float[np.ndarray, "4 4"] | None = None,
) -> LoadedCloud:
    """Make an observation of the point clouds of one clip.

    A camera without pose does not know where up is: its frame is turned so that the ground that
    RANSAC finds in the points lies at z = 0; where none is found, the camera is taken as held
    level, and the lowest points as being on the ground. `ground_known` is then false. Where a
    ground is seen, it and what is not the person on it are left out; of scans without a ground as
    well, if that is much, and in any case where something of a person's size stands beside.

    Args:
        file: as read.
        body: that is to be fitted.
        points: most points kept of a frame, drawn at random.
        seed: of the draw.
        T_recording_camera: where a camera without pose is, if the ground is given.

    Raises:
        ValueError: when no frame has enough points of a person, nobody stands or lies on the
            ground that is seen, scans show a ground that is not
            where it should be, a fixed sensor moves, or there are more frames than memory for
            them.
    """
    frames = _checked_frame_count(file, points)
    known = file.camera is None or file.camera.T_camera_world is not None
    generator = np.random.default_rng(seed)
    up = np.array(_UP_IN_WORLD if known else _UP_IN_CAMERA)
    order = np.argsort(file.frame, kind="stable")
    ends = np.searchsorted(file.frame[order], np.arange(1, frames))
    clouds = np.split(file.points[order], ends)
    moves, found = sensor_movement(file.camera, clouds, up), find_ground(clouds, up)
    T = np.eye(4)
    if not known:
        given = T_recording_camera
        T = _pose_above_ground(file.points, found.ground) if given is None else given
    clouds = [cloud @ T[:3, :3].T + T[:3, 3] for cloud in clouds]
    walls = _walls(file.camera, clouds, T)
    seen = found.ground is not None
    if known and found.ground is not None:
        seen = abs(float(found.ground.offset)) < _KNOWN_GROUND
        if file.camera is None and not seen:
            raise ObservationError(
                f"the points show a ground at z = {float(found.ground.offset):.2f} m, expected it "
                "at z = 0: move the points so that it is, or leave out the points that are no "
                "person"
            )
    if seen:
        clouds = [cloud[above_ground(cloud, _LEVEL)] for cloud in clouds]
    for wall in walls:
        clouds = [cloud[in_front_of_plane(cloud, *wall)] for cloud in clouds]
    shown = [cloud for cloud in clouds if len(cloud) > 1]
    sparse = _SPACINGS * point_spacing(shown[:: max(1, len(shown) // _LOOKED_AT)])
    person, beside = clusters_of_one_person(clouds, max(_REACH, sparse))
    left_out = 1 - sum(map(len, person)) / max(sum(map(len, clouds)), 1)
    if seen or len(walls) > 0 or (file.camera is None and left_out > _MUCH) or beside > 0:
        clouds = person
    if seen:
        clouds = _without_noise_of_ground(clouds)
    clouds = [
        cloud[np.sort(generator.permutation(len(cloud))[:points])]
        if len(cloud) > points
        else cloud
        for cloud in clouds
    ]
    lowest = np.median([np.percentile(cloud[:, 2], 1) for cloud in clouds if len(cloud) > 0] or 0)
    if file.camera is None and not seen and lowest < _BELOW:
        known = False
        said = f"ground: the lowest points are at {lowest:.2f} m, so its height is estimated"
        moves = (*moves, f"{said} instead of z = 0")
    most = max(map(len, clouds))
    if most < _LEAST:
        raise ObservationError(
            f"the fullest of {frames} frames has {most} points of a person; expected {_LEAST} or "
            "more, so check unit, axes and mask"
        )
    precision = np.float64 if body.template.dtype == torch.float64 else np.float32
    padded = np.zeros((1, frames, most, 3), precision)
    present = np.zeros((1, frames, most), np.bool_)
    for k, cloud in enumerate(clouds):
        padded[0, k, : len(cloud)], present[0, k, : len(cloud)] = cloud, True
    camera = None
    if file.camera is not None:
        view = undistorted_camera(file.camera, T, torch.float64)[None]
        camera = view.to(device=body.template.device, dtype=body.template.dtype)
    observation = PointCloud(
        points=torch.from_numpy(padded).to(body.template),
        present=torch.from_numpy(present).to(body.template.device),
        surfels=Surfels.of(body),
        fps=file.fps,
        start_time=file.start_time,
        camera=camera,
        std=None if camera is None else _distance_noise(padded, present, camera),
        ground_known=known,
        ground_seen=found.ground is not None,
    )
    if beside > 0:
        moves = (
            *moves,
            f"in {beside} of {frames} frames something of a person's size stands beside what is "
            "followed as the person, and is left out; if the person was left out, cut everything "
            "else out of the scans (--masks for depth images)",
        )
    return LoadedCloud(observation, found, T, moves)


def _without_noise_of_ground(clouds: list[np.ndarray]) -> list[np.ndarray]:
    """Return the clouds, emptied in frames that show only noise of the ground.

    Flat frames with few points, compared with frames in which something rises above the ground,
    are noise. So is something that rises in hardly any frame.

    Raises:
        ObservationError: when nothing rises above the ground in at least `_SHOWN` of the frames.
    """
    rises = [len(cloud) >= _LEAST and _rises_above_ground(cloud) for cloud in clouds]
    if sum(rises) <= _SHOWN * len(clouds):
        where = f", but in {sum(rises)} of {len(clouds)} frames" if any(rises) else ""
        raise ObservationError(
            f"the ground is seen, but nothing rises more than {_FLAT} m above it{where}: nobody "
            "is in the sensor's reach, or the person was cut out; expected points of a person"
        )
    usual = np.median([len(cloud) for cloud, up in zip(clouds, rises, strict=True) if up])
    return [
        cloud if up or len(cloud) > _FEW * usual else cloud[:0]
        for cloud, up in zip(clouds, rises, strict=True)
    ]


def _rises_above_ground(cloud: Float[np.ndarray, "points 3"]) -> bool:
    """Return whether points rise above the ground z = 0 and are not its wide, flat noise."""
    wide = np.ptp(np.quantile(cloud[:, :2], (0.05, 0.95), axis=0), axis=0).max() > _WIDE
    return bool(np.quantile(cloud[:, 2], 0.5 if wide else 0.9) > _FLAT)


def _walls(
    camera: CameraArrays | None, clouds: list[np.ndarray], T: Float[np.ndarray, "4 4"]
) -> list[tuple[Float[np.ndarray, "3"], float, Float[np.ndarray, "3"]]]:
    """Return each wall's normal and offset, with the sensor's position, in the recording's frame.

    The list is empty for scans, which have no sensor, and for a sensor that moves.
    """
    if camera is None or camera.pose_count > 1:
        return []
    eye = T[:3, :3] @ sensor_position(camera) + T[:3, 3]
    return [(normal, offset, eye) for normal, offset in find_walls(clouds, eye)]


def _distance_noise(
    points: Float[np.ndarray, "1 moments points 3"],
    present: Bool[np.ndarray, "1 moments points"],
    camera: Camera,
) -> Float[np.ndarray, "1 moments"]:
    """Return the standard deviation of a depth sensor's distances in every frame, metres."""
    eye = camera.at(range(points.shape[1])).T_world_camera[0, :, :3, 3].double().cpu().numpy()
    return depth_noise(points[0], present[0], np.broadcast_to(eye, (points.shape[1], 3)))[None]


def _checked_frame_count(file: PointsFile, points_per_frame: int) -> int:
    """Return the number of frames after checking that the padded points fit into memory.

    Raises:
        ValueError: when there are too many of them.
    """
    frames = int(file.frame.max()) + 1
    if file.truth_visible is not None:
        frames = max(frames, len(file.truth_visible))
    FRAMES.check(frames, "points", "frame")
    fullest = int(np.unique(file.frame, return_counts=True)[1].max())
    PADDED_CLOUD.check(frames * min(fullest, points_per_frame), "points", "frame")
    return frames


def _pose_above_ground(
    points: Float[np.ndarray, "points 3"], ground: Ground | None
) -> Float[np.ndarray, "4 4"]:
    """Return T_recording_camera: z up, y along the view, the sensor above the origin."""
    up = np.array(_UP_IN_CAMERA)
    if ground is not None:
        up = ground.normal.double().numpy()
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cross(ahead, up), ahead, up])
    lowest = np.percentile(points @ up, 1) if ground is None else float(ground.offset)
    T[2, 3] = -lowest
    return T
