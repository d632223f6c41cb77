"""Simulates keypoints that cameras see of a known motion: noise, occlusion, misses."""

import math
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.correspondences import BodyPoints
from recon.body.model import BodyModel
from recon.core.camera import Camera, full_hd_camera, pose_looking_at
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.formats.calibration import load_cameras
from recon.formats.observations import CameraArrays, KeypointsFile
from recon.simulation.points import Corner, Corruption
from recon.simulation.settings import FilmSettings

AIM = 1.0
"""Height of the point that cameras of a dome look at, metres."""
_ROOM = 1.15
"""A dome's cameras see the whole body with this much to spare."""
_SURE, _UNSURE = 0.95, 0.3
"""Confidence of a point found exactly, and of one found four standard deviations off."""


def camera_ring(
    motion: Motion,
    body: BodyModel,
    camera: Camera,
    count: int,
    *,
    height: float = 1.6,
    first: float = 0.0,
) -> tuple[Camera, ...]:
    """Place fixed cameras evenly around a motion, so that the person fills each image.

    Args:
        motion: of one clip, no batch axis.
        body: whose motion it is.
        camera: its intrinsics.
        count: how many; two look from directions 90 degrees apart, not from opposite sides.
        height: of the cameras, metres.
        first: direction from the body to the first camera, radians from the world's x axis.
    """
    joints = body.pose(motion).joints
    middle = (joints.flatten(0, -2).amin(0) + joints.flatten(0, -2).amax(0)) / 2
    target = torch.cat((middle[:2], middle.new_tensor([AIM])))
    reach = (joints[..., :2] - target[:2]).norm(dim=-1).max()
    tall = joints[..., 2].max().clamp(min=AIM) + 0.15
    width, rows = camera.image_size
    focal = camera.camera_matrix[[0, 1], [0, 1]]
    sideways = _ROOM * reach * (2 * focal[0] / width + 1)
    upright = _ROOM * torch.maximum(tall - AIM, torch.tensor(AIM)) * 2 * focal[1] / rows + reach
    distance = torch.maximum(sideways, upright)
    step = math.tau / 4 if count == 2 else math.tau / max(count, 1)
    placed = []
    for k in range(count):
        angle = first + k * step
        level = distance * target.new_tensor([math.cos(angle), math.sin(angle)])
        position = torch.cat((target[:2] + level, target.new_tensor([height])))
        placed.append(camera.placed(position, target))
    return tuple(placed)


def orbiting_camera(
    camera: Camera, target: Float[Tensor, "3"], frames: int, angle: float, sway: float = 0.05
) -> Camera:
    """Return a hand-held camera that orbits a target by `angle` radians, swaying by `sway` m."""
    start = camera.T_world_camera[:3, 3] - target
    poses = []
    for k in range(frames):
        turn = angle * k / max(frames - 1, 1)
        c, s = math.cos(turn), math.sin(turn)
        at = start.new_tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ start
        at = at + sway * start.new_tensor([0.0, math.sin(0.21 * k), math.sin(0.42 * k)])
        poses.append(pose_looking_at(target + at, target))
    return camera.replace(T_camera_world=torch.stack(poses))


def keypoints2d(
    motion: Motion,
    body: BodyModel,
    camera: Camera,
    corruption: Corruption,
    seed: int,
    layout: str = "openpose25",
) -> KeypointsFile:
    """Simulate a detector's 2D keypoints of one clip (no batch axis); noise in pixels.

    A box hides what lies behind it. Confidence falls with the error, as detectors know a little
    of their errors; what is hidden or outside the image has none.

    Args:
        motion: the truth.
        body: whose motion it is.
        camera: fixed, or one pose per frame.
        corruption: of the image.
        seed: of everything random.
        layout: which keypoints.
    """
    generator = torch.Generator().manual_seed(seed)
    posed = body.pose(motion)
    points = BodyPoints.of_layout(layout, body).of(posed)
    visible = in_sight(points, camera, corruption, motion, generator)
    true = camera.project(points).pixels
    noise = torch.randn(true.shape, generator=generator).to(true)
    wild = torch.rand(true.shape[:2], generator=generator) < corruption.outliers
    size = true.new_tensor(camera.image_size)
    anywhere = torch.rand(true.shape, generator=generator).to(true) * size
    pixels = torch.where(wild[..., None], anywhere, true + corruption.noise * noise)
    off = noise.norm(dim=-1) / 4
    confidence = _SURE - (_SURE - _UNSURE) * off.clamp(max=1)
    confidence = torch.where(visible, confidence, 0.0)
    clear = replace(corruption, missing_points=0.0, missing_frames=0.0)
    truth_visible = in_sight(posed.joints, camera, clear, motion, generator)
    return KeypointsFile(
        pixels=torch.where(visible[..., None], pixels, 0.0).double().numpy(),
        confidence=confidence.double().numpy(),
        layout=layout,
        fps=motion.fps,
        camera=camera_arrays(camera),
        start_time=motion.start_time,
        truth_visible=truth_visible.numpy(),
    )


def camera_arrays(camera: Camera) -> CameraArrays:
    """Convert a camera to the NumPy arrays that observation files store."""
    poses = camera.T_camera_world
    return CameraArrays(
        camera.camera_matrix.double().numpy(),
        camera.image_size,
        None if camera.distortion is None else camera.distortion.double().numpy(),
        (poses if poses.ndim == 3 else poses[None]).double().numpy(),
    )


def in_sight(
    points: Float[Tensor, "time points 3"],
    camera: Camera,
    corruption: Corruption,
    motion: Motion,
    generator: torch.Generator,
) -> Bool[Tensor, "time points"]:
    """Return a mask of the points inside the image that the corruption does not hide."""
    projected = camera.project(points)
    seen = projected.in_front & camera.in_image(projected.pixels)
    boxless = replace(corruption, hide_box=None)
    seen &= boxless.visible(points, generator, motion.times)
    if corruption.hide_box is not None:
        origin = camera.T_world_camera[..., :3, 3].expand(len(points), 3)[:, None]
        blocked = crosses_box(origin, points, corruption.hide_box)
        seen &= ~(blocked & corruption.active(motion.times)[:, None])
    return seen


def crosses_box(
    origin: Float[Tensor, "*#shape 3"], end: Float[Tensor, "*#shape 3"], box: tuple[Corner, Corner]
) -> Bool[Tensor, "*shape"]:
    """Whether the line from one point to another crosses a box (slab test)."""
    low, high = end.new_tensor(box)
    way = end - origin
    way = torch.where(way.abs() < 1e-12, 1e-12, way)
    a, b = (low - origin) / way, (high - origin) / way
    enter = torch.minimum(a, b).amax(-1).clamp(min=0)
    leave = torch.maximum(a, b).amin(-1).clamp(max=1)
    return enter < leave


_PRESETS = {"front": 0.0, "side": math.tau / 4}
"""Angle of a preset's first camera from where the body faces, radians."""


def cameras_around(
    truth: Motion, body: BodyModel, film: FilmSettings, lens: Camera | None = None
) -> dict[str, Camera]:
    """Return simulated cameras by name, from a preset (front, side) or a calibration.

    Args:
        truth: one clip (no batch axis).
        body: whose motion it is.
        film: which cameras; one from a calibration without a pose is placed in front.
        lens: of a preset's cameras; default: full HD.

    Raises:
        FileNotFoundError: when there is no such calibration.
        ValueError: when it is damaged or does not say where its cameras are, or cameras that move
            already are to be carried around.
    """
    if film.views < 1:
        raise ReconError(f"views: expected one camera or more, got {film.views}")
    lens = full_hd_camera() if lens is None else lens
    if film.camera in _PRESETS:
        first = mean_heading(truth) + _PRESETS[film.camera]
        placed = camera_ring(
            truth, body, lens.to(dtype=truth.translation.dtype), film.views, first=first
        )
        cameras = {f"cam{k}": camera for k, camera in enumerate(placed, 1)}
    else:
        cameras = _cameras_of_calibration(Path(film.camera), truth, body, film.views)
    if film.orbit == 0:
        return cameras
    if any(camera.T_camera_world.ndim == 3 for camera in cameras.values()):
        raise ReconError(f"{film.camera}: its cameras move already; leave orbit out")
    middle = body.pose(truth).joints.flatten(0, -2).mean(0)
    return {n: orbiting_camera(c, middle, truth.frames, film.orbit) for n, c in cameras.items()}


def _cameras_of_calibration(
    path: Path, truth: Motion, body: BodyModel, views: int
) -> dict[str, Camera]:
    if not path.exists():
        raise FileNotFoundError(
            f"{path}: no such calibration; expected a file, or one of {', '.join(_PRESETS)}"
        )
    found = load_cameras(path).cameras
    if views != 1:
        raise ReconError(f"{path} already lists the cameras ({len(found)}); leave views out")
    cameras = {}
    for name, arrays in found.items():
        camera = _camera_of_arrays(arrays, truth)
        if arrays.T_camera_world is None:
            if len(found) > 1:
                raise ReconError(f"{path}: camera {name} has no pose; give each camera a pose")
            camera = camera_ring(truth, body, camera, 1, first=mean_heading(truth))[0]
        elif camera.T_camera_world.ndim == 3 and len(camera.T_camera_world) != truth.frames:
            raise ReconError(
                f"{path}: camera {name} has {len(camera.T_camera_world)} poses, but the "
                f"motion has {truth.frames} frames; give one pose, or one per frame"
            )
        cameras[name] = camera
    return cameras


def _camera_of_arrays(arrays: CameraArrays, truth: Motion) -> Camera:
    """Convert a camera's NumPy arrays to a `Camera` in the precision of the motion."""
    poses = arrays.T_camera_world
    if poses is not None and len(poses) == 1:
        poses = poses[0]
    return Camera.create(
        torch.from_numpy(arrays.camera_matrix),
        arrays.image_size,
        None if arrays.distortion is None else torch.from_numpy(arrays.distortion),
        None if poses is None else torch.from_numpy(poses),
    ).to(dtype=truth.translation.dtype)


def mean_heading(truth: Motion) -> float:
    """The mean heading of the body, radians from the world's x axis."""
    x, y, _ = truth.rotations[:, 0, :, 2].mean(0).tolist()
    return math.atan2(y, x)
