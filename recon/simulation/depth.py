"""Simulates depth sensors that watch a known motion: noise, holes, furniture.

Depths come from the rasteriser that draws our pictures, so what hides what is exact to a pixel.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from recon.body.model import BodyModel
from recon.core.camera import NEAREST, Camera
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.raster import rasterise
from recon.formats.observations import PointsFile
from recon.simulation.images import camera_arrays, in_sight
from recon.simulation.points import Corner, Corruption
from recon.simulation.scenery import FurnitureMesh

POINTS = 4096


@dataclass(frozen=True)
class WatchedSurface:
    """A moving triangle mesh with its 22 joints, in metres, that a simulated sensor sees."""

    vertices: Float[torch.Tensor, "time vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    joints: Float[torch.Tensor, "time 22 3"]

    @classmethod
    def of(cls, motion: Motion, body: BodyModel) -> "WatchedSurface":
        """Pose the body model by a motion of one clip; return its vertices, faces and joints."""
        posed = body.pose(motion)
        return cls(posed.vertices, body.faces.cpu().numpy(), posed.joints)


class PixelSurface(IntEnum):
    """The kind of surface that a pixel shows: nothing, body, furniture or ground."""

    NOTHING = 0
    BODY = 1
    BOX = 2
    GROUND = 3
    FURNITURE = 4


@dataclass(frozen=True)
class DepthSensor:
    """Settings of the errors of a depth sensor.

    Depth has the standard deviation constant + quadratic (z - 0.4 m)², the law of Nguyen, Izadi
    & Lovell (2012) for the first Kinect. Surfaces seen from the side give no depth at times, and
    pixels on an edge lie anywhere between what is before and behind it ("flying pixels").
    """

    constant: float = 0.0012
    """Standard deviation of a depth of 0.4 m, metres."""
    quadratic: float = 0.0019
    """Factor of (depth - 0.4 m)² in the standard deviation, per metre."""
    grazing: float = 75.0
    """Degrees between the view and the surface's normal from which on pixels get lost."""
    lost: float = 0.6
    """Share of these pixels that is lost."""
    flying: float = 0.1
    """Share of the pixels on an edge that fly; the others are lost as `lost` says."""
    farthest: float = 8.0
    """Metres."""

    def deviation(self, depth: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Standard deviation of depths measured at these true depths, metres."""
        return self.constant + self.quadratic * np.square(depth - 0.4)


PERFECT = DepthSensor(constant=0.0, quadratic=0.0, lost=0.0, flying=0.0)
"""A sensor without error."""
_EDGE = 0.05
"""Metres between neighbouring pixels that make an edge."""


def depth_points(
    motion: Motion,
    body: BodyModel,
    camera: Camera,
    corruption: Corruption,
    seed: int,
    *,
    sensor: DepthSensor | None = None,
    points: int = POINTS,
    surfaces: tuple[PixelSurface, ...] = (PixelSurface.BODY,),
    furniture: FurnitureMesh | None = None,
    shown: WatchedSurface | None = None,
) -> PointsFile:
    """Points that a depth sensor sees during one clip (no batch axis), in the world.

    The corruption's box stands in the room while it is active and hides what is behind it. Its
    height hides everything lower, as a thing does that stands before the sensor and ends at that
    height: surfaces below it and flying pixels that would lie below it give no point. Missing
    frames show nothing, outliers are points up to half a metre off (so that some may lie below
    the height), and missing points thin the cloud. The noise is the sensor's.

    Args:
        motion: the truth.
        body: whose motion it is.
        camera: fixed, or one pose per frame; it must look from outside the body.
        corruption: what stands in the way.
        seed: of everything random.
        sensor: how it errs.
        points: most points of a frame.
        surfaces: what a segmentation leaves: the body alone, or what is around it as well.
        furniture: what stands in the room and hides what is behind it, metres.
        shown: who is seen in every frame of the motion instead of our body.

    Raises:
        ValueError: when the camera sees none of it in any frame.
    """
    sensor = DepthSensor() if sensor is None else sensor
    random, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    shown = WatchedSurface.of(motion, body) if shown is None else shown
    active = corruption.active(motion.times).tolist()
    recorded = torch.rand(motion.frames, generator=generator) >= corruption.missing_frames
    poses = camera.T_camera_world.expand(motion.frames, 4, 4)
    clouds: list[np.ndarray] = []
    for k in range(motion.frames):
        view = camera.replace(T_camera_world=poses[k])
        cloud = np.zeros((0, 3))
        if recorded[k]:
            box = corruption.hide_box if active[k] else None
            true, surface = depth_image(shown.vertices[k], shown.faces, view, box, furniture)
            depth = measured_depth(true, view, sensor, random)
            kept = np.isin(surface, surfaces) & (depth > 0)
            if active[k] and corruption.hide_below is not None:
                # hide by the true depth too, so that noise cannot make hidden surfaces visible
                kept &= heights_of_pixels(true, view) >= corruption.hide_below
                kept &= heights_of_pixels(depth, view) >= corruption.hide_below
            cloud = _world_points(depth, kept, view, corruption, points, random)
        clouds.append(cloud)
    if not any(map(len, clouds)):
        raise ReconError(
            "the sensor sees nothing of this motion; place it 2 to 4 m away, looking at the body"
        )
    clear = replace(corruption, missing_points=0.0, missing_frames=0.0)
    seen = in_sight(shown.joints, camera, clear, motion, generator)
    seen &= camera.project(shown.joints).depth <= sensor.farthest
    return PointsFile(
        points=np.concatenate(clouds),
        frame=np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds]),
        fps=motion.fps,
        camera=camera_arrays(camera),
        start_time=motion.start_time,
        truth_visible=seen.numpy(),
    )


def without_pose(file: PointsFile) -> PointsFile:
    """Transform points to the frame of their fixed sensor, and remove the sensor's pose.

    Raises:
        ValueError: when it has no pose, or moves.
    """
    camera = file.camera
    if camera is None or camera.T_camera_world is None or len(camera.T_camera_world) != 1:
        raise ReconError("expected a fixed sensor, since points of a moving one need its poses")
    T = camera.T_camera_world[0]
    points = file.points @ T[:3, :3].T + T[:3, 3]
    return replace(file, points=points, camera=replace(camera, T_camera_world=None))


def depth_image(
    vertices: torch.Tensor,
    faces: Int[np.ndarray, "faces 3"],
    camera: Camera,
    box: tuple[Corner, Corner] | None,
    furniture: FurnitureMesh | None = None,
) -> tuple[Float[np.ndarray, "height width"], Int[np.ndarray, "height width"]]:
    """Render the true depth of every pixel, metres (0: nothing), and its `PixelSurface`."""
    width, height = camera.image_size
    layers = [np.full((height, width), np.inf), _depth_of_mesh(vertices, faces, camera)]
    # world points at a depth of one metre on every pixel's ray
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = torch.from_numpy(np.stack([u, v], -1).reshape(-1, 2)).to(vertices)
    origin = camera.T_world_camera[:3, 3].double().numpy()
    ray = camera.unproject(pixels, torch.ones_like(pixels[:, 0])).double().numpy() - origin
    ray = np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    layers.append(_depth_of_box(origin, ray, box).reshape(height, width))
    ground = -origin[2] / ray[:, 2]
    layers.append(np.where(ground > NEAREST, ground, np.inf).reshape(height, width))
    if furniture is not None:
        corners = torch.from_numpy(furniture.vertices).to(vertices)
        layers.append(_depth_of_mesh(corners, furniture.faces, camera))
    surface = np.stack(layers).argmin(0)
    depth = np.take_along_axis(np.stack(layers), surface[None], 0)[0]
    return np.where(np.isfinite(depth), depth, 0.0), surface


def _depth_of_mesh(
    vertices: torch.Tensor, faces: Int[np.ndarray, "faces 3"], camera: Camera
) -> Float[np.ndarray, "height width"]:
    """Render the depth of a mesh at every pixel, metres; infinity where it is not seen."""
    projected = camera.project(vertices)
    drawn = faces[projected.in_front.numpy()[faces].all(1)]
    pixels, depth = projected.pixels.double().numpy(), projected.depth.double().numpy()
    return rasterise(pixels, depth, drawn, camera.image_size).depth.astype(np.float64)


def heights_of_pixels(
    depth: Float[np.ndarray, "height width"], camera: Camera
) -> Float[np.ndarray, "height width"]:
    """Return the height above z = 0 of the surface point at every pixel, metres."""
    v, u = np.indices(depth.shape)
    pixels = torch.from_numpy(np.stack([u, v], -1).reshape(-1, 2) + 0.5)
    sensor = camera.to(dtype=torch.float64)
    points = sensor.unproject(pixels, torch.from_numpy(depth.reshape(-1)).double())
    return points[:, 2].numpy().reshape(depth.shape)


def measured_depth(
    depth: Float[np.ndarray, "height width"],
    camera: Camera,
    sensor: DepthSensor,
    random: np.random.Generator,
) -> Float[np.ndarray, "height width"]:
    """Simulate measured depths from true ones: with noise, and 0 where nothing is measured."""
    padded = np.pad(depth, 1, mode="edge")
    around = np.stack([padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1]])
    step = np.abs(around - depth)
    edge = (step > _EDGE).any(0)
    focal = float(camera.camera_matrix[0, 0])
    # depths of neighbouring pixels on a slanted plane differ by z / f · tan(angle)
    slope = np.where(step > _EDGE, 0.0, step).max(0) * focal / np.maximum(depth, NEAREST)
    slanted = slope > np.tan(np.radians(sensor.grazing))
    noisy = depth + sensor.deviation(depth) * random.standard_normal(depth.shape)
    other = np.take_along_axis(around, step.argmax(0)[None], 0)[0]
    flies = edge & (other > 0) & (random.random(depth.shape) < sensor.flying)
    noisy = np.where(flies, depth + random.random(depth.shape) * (other - depth), noisy)
    lost = (edge & ~flies | slanted) & (random.random(depth.shape) < sensor.lost)
    return np.where((depth > 0) & ~lost & (noisy < sensor.farthest), np.maximum(noisy, 0.0), 0.0)


def _world_points(
    depth: Float[np.ndarray, "height width"],
    kept: Bool[np.ndarray, "height width"],
    camera: Camera,
    corruption: Corruption,
    count: int,
    random: np.random.Generator,
) -> Float[np.ndarray, "points 3"]:
    """Convert at most `count` of the kept pixels to world points, some missing or outliers."""
    row, column = np.nonzero(kept)
    chosen = random.random(len(row)) >= corruption.missing_points
    row, column = row[chosen], column[chosen]
    if len(row) > count:
        chosen = np.sort(random.permutation(len(row))[:count])
        row, column = row[chosen], column[chosen]
    pixels = torch.from_numpy(np.stack([column, row], 1) + 0.5)
    sensor = camera.to(dtype=torch.float64)
    cloud = sensor.unproject(pixels, torch.from_numpy(depth[row, column])).numpy()
    wild = random.random(len(cloud)) < corruption.outliers
    return cloud + np.where(wild[:, None], random.random(cloud.shape) - 0.5, 0.0)


def _depth_of_box(
    origin: Float[np.ndarray, "3"],
    ray: Float[np.ndarray, "rays 3"],
    box: tuple[Corner, Corner] | None,
) -> Float[np.ndarray, " rays"]:
    """Return where rays enter an axis-aligned box, as multiples of `ray`; infinity if not."""
    if box is None:
        return np.full(len(ray), np.inf)
    a, b = (np.asarray(box[0]) - origin) / ray, (np.asarray(box[1]) - origin) / ray
    enter = np.minimum(a, b).max(1)
    leave = np.maximum(a, b).min(1)
    return np.where((enter < leave) & (enter > NEAREST), enter, np.inf)
