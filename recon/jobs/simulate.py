"""A motion file as sensors would have seen it, as observation files: what `simulate` does."""

import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch

from recon.body.landmarks import KEYPOINTS_43, LANDMARKS_16
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.camera import Camera, depth_camera, full_hd_camera
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.formats.calibration.cameras import load_cameras
from recon.formats.clouds.scans import write_scans
from recon.formats.observations import (
    CameraArrays,
    KeypointsFile,
    ObservationFile,
    PointsFile,
    PositionsFile,
    save_observation,
)
from recon.formats.results.inputs import paths_in
from recon.formats.results.outputs import Kind, Output
from recon.formats.results.reports import checksums, versions
from recon.formats.results.writing import writing
from recon.simulation.clothes import clothed
from recon.simulation.depth import DepthSensor, depth_points, without_pose
from recon.simulation.images import dome, keypoints2d, orbiting
from recon.simulation.points import Corruption, joints3d, landmarks3d, markers3d, visible_joints
from recon.simulation.scans import scan_points
from recon.simulation.settings import (
    FILM_DEFAULTS,
    SURFACE_DEFAULTS,
    FilmSettings,
    SensorKind,
    SurfaceSettings,
)

_PRESETS = {"front": 0.0, "side": math.tau / 4}
"""Angle of a preset's first camera from where the body faces, radians."""

_BUNDLED_ONLY = "sensors are simulated of motions of the bundled body only, such as fits of it"
"""What to do about a motion of another body."""


def simulate_file(
    motion: Path,
    out: Path,
    kind: SensorKind,
    corruption: Corruption,
    *,
    seed: int,
    fps: float | None = None,
    frames: tuple[int, int] | None = None,
    unknown_ground: bool = False,
    film: FilmSettings = FILM_DEFAULTS,
    surface: SurfaceSettings = SURFACE_DEFAULTS,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write what a sensor would have seen of a motion file; returns what was written.

    One camera writes OUT, several write OUT/CAMERA.npz; scans whose OUT does not end in .npz are a
    folder of PLY files with times.csv. A report is beside every file, and in every folder.

    Raises:
        FileNotFoundError: when there is no such motion or calibration.
        ValueError: when one is damaged, the motion has fewer frames than asked for, or options
            contradict each other; nothing is written then.
        FileExistsError: when a file to write is there and recon did not write it, unless
            `overwrite`.
    """
    _check_apply(kind, film, surface, corruption)
    body = BodyModel.load()
    truth = load_motion_of(motion, body, _BUNDLED_ONLY).motion
    if frames is not None:
        if frames[1] > truth.frames:
            raise ValueError(f"{motion}: has {truth.frames} frames, asked for {frames}")
        truth = truth.window(*frames)
    truth = truth if fps is None else truth.resample(fps)
    files: dict[str, ObservationFile]
    if kind in ("keypoints2d", "depth"):
        files = _filmed(
            truth, body, kind, corruption, seed, film, surface, unknown_ground=unknown_ground
        )
    elif kind == "scans":
        if unknown_ground:
            raise ValueError("scans stand in the world; --unknown-ground does not apply to them")
        seen = _dressed(body, surface)
        files = {"": scan_points(truth, seen, corruption, seed, points=surface.points)}
    else:
        known = not unknown_ground
        files = {"": _tracked(truth, body, kind, corruption, seed, surface, ground_known=known)}
    if len(files) > 1 and out.suffix == ".npz":
        raise ValueError(f"{out} is one file, but there are {len(files)} cameras; give a folder")
    report = {
        "kind": kind,
        "settings": {
            **asdict(corruption), **asdict(film), **asdict(surface), "seed": seed, "fps": fps,
            "frames": frames, "unknown_ground": unknown_ground,
        },
        "inputs": checksums([motion, *paths_in(film)]),
        "versions": versions(),
    }  # fmt: skip
    scans = kind == "scans" and out.suffix != ".npz"
    output = Output(out, Kind.FOLDER if scans or len(files) > 1 else Kind.FILE)
    with writing(output, report=report, overwrite=overwrite) as (staged,):
        for name, file in files.items():
            if scans:
                assert isinstance(file, PointsFile)
                write_scans(staged, file)
            else:
                save_observation(staged / f"{name}.npz" if len(files) > 1 else staged, file)
    return tuple(out / f"{name}.npz" for name in files) if len(files) > 1 else (out,)


def _check_apply(
    kind: SensorKind, film: FilmSettings, surface: SurfaceSettings, corruption: Corruption
) -> None:
    """Refuse options that would have no effect."""
    if kind not in ("keypoints2d", "depth") and film != FILM_DEFAULTS:
        raise ValueError(f"--camera, --views, --orbit and --layout do not apply to {kind}")
    clouds = replace(surface, skin_offset=SURFACE_DEFAULTS.skin_offset)
    if kind not in ("depth", "scans") and clouds != SURFACE_DEFAULTS:
        raise ValueError(f"--points and --clothed are of depth and scans, not of {kind}")
    hides = corruption.hide_below is not None or corruption.hide_box is not None
    if corruption.during is not None and not hides:
        raise ValueError(
            "--during says when things are hidden, but nothing is; add --hide-below or "
            "--occluder, or leave --during out"
        )
    if surface.points < 1:
        raise ValueError(f"--points is one or more, got {surface.points}")
    if kind != "landmarks" and surface.skin_offset != SURFACE_DEFAULTS.skin_offset:
        raise ValueError(f"--skin-offset is of landmarks, not of {kind}")


def _dressed(body: BodyModel, surface: SurfaceSettings) -> BodyModel:
    return body if surface.clothed is None else clothed(body, surface.clothed)


def _tracked(
    truth: Motion,
    body: BodyModel,
    kind: SensorKind,
    corruption: Corruption,
    seed: int,
    surface: SurfaceSettings,
    *,
    ground_known: bool,
) -> PositionsFile:
    """Joints or markers."""
    if kind == "joints3d":
        seen, names = joints3d(truth, body, corruption, seed), JOINTS
    elif kind == "markers3d":
        seen, names = markers3d(truth, body, corruption, seed), KEYPOINTS_43
    else:
        away = surface.skin_offset
        seen = landmarks3d(truth, body, corruption, seed, skin_offset=away)
        names = LANDMARKS_16
    return PositionsFile(
        kind="joints3d" if kind == "joints3d" else "markers3d",
        positions=seen.positions.double().numpy(),
        visible=seen.visible.numpy(),
        names=names,
        fps=truth.fps,
        start_time=truth.start_time,
        ground_known=ground_known,
        truth_visible=visible_joints(truth, body, corruption, seed).numpy(),
    )


def _filmed(
    truth: Motion,
    body: BodyModel,
    kind: SensorKind,
    corruption: Corruption,
    seed: int,
    film: FilmSettings,
    surface: SurfaceSettings,
    *,
    unknown_ground: bool,
) -> dict[str, ObservationFile]:
    """One observation per camera, by its name."""
    if kind == "depth" and film.layout != FILM_DEFAULTS.layout:
        raise ValueError("--layout is of keypoints; depth has none")
    cameras = cameras_around(truth, body, film, depth_camera() if kind == "depth" else None)
    if unknown_ground and len(cameras) > 1:
        raise ValueError(
            f"{len(cameras)} views without their poses cannot be put together; film with one "
            "camera, or leave --unknown-ground out"
        )
    files: dict[str, ObservationFile] = {}
    for k, (name, camera) in enumerate(cameras.items()):
        # 100 views have seeds of their own before they meet those of the next --seed
        own = 100 * seed + k
        if kind == "depth":
            quiet, sensor = replace(corruption, noise=0.0), DepthSensor()
            sensor = replace(sensor, constant=math.hypot(sensor.constant, corruption.noise))
            file = depth_points(
                truth, _dressed(body, surface), camera, quiet, own,
                sensor=sensor, points=surface.points,
            )  # fmt: skip
        else:
            file = keypoints2d(truth, body, camera, corruption, own, film.layout)
            if not (file.confidence > 0).any():
                raise ValueError(f"camera {name} sees nothing of the motion in any frame")
        files[name] = _lost(file) if unknown_ground else file
    return files


def cameras_around(
    truth: Motion, body: BodyModel, film: FilmSettings, lens: Camera | None = None
) -> dict[str, Camera]:
    """The cameras of a preset or of a calibration, by name.

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
        raise ValueError(f"--views is one camera or more, got {film.views}")
    lens = full_hd_camera() if lens is None else lens
    if film.camera in _PRESETS:
        first = _heading(truth) + _PRESETS[film.camera]
        placed = dome(truth, body, lens.to(dtype=truth.translation.dtype), film.views, first=first)
        cameras = {f"cam{k}": camera for k, camera in enumerate(placed, 1)}
    else:
        cameras = _calibrated(Path(film.camera), truth, body, film.views)
    if film.orbit == 0:
        return cameras
    if any(camera.T_camera_world.ndim == 3 for camera in cameras.values()):
        raise ValueError(f"{film.camera}: its cameras move already; leave --orbit out")
    middle = body.pose(truth).joints.flatten(0, -2).mean(0)
    return {n: orbiting(c, middle, truth.frames, film.orbit) for n, c in cameras.items()}


def _calibrated(path: Path, truth: Motion, body: BodyModel, views: int) -> dict[str, Camera]:
    if not path.exists():
        raise FileNotFoundError(
            f"{path}: no such calibration; expected a file, or one of {', '.join(_PRESETS)}"
        )
    found = load_cameras(path).cameras
    if views != 1:
        raise ValueError(f"{path} says which cameras there are ({len(found)}); leave --views out")
    cameras = {}
    for name, arrays in found.items():
        camera = _camera(arrays, truth)
        if arrays.T_camera_world is None:
            if len(found) > 1:
                raise ValueError(f"{path}: camera {name} has no pose, so it cannot be placed")
            camera = dome(truth, body, camera, 1, first=_heading(truth))[0]
        elif camera.T_camera_world.ndim == 3 and len(camera.T_camera_world) < truth.frames:
            raise ValueError(
                f"{path}: camera {name} has {len(camera.T_camera_world)} poses, the motion "
                f"{truth.frames} frames"
            )
        elif camera.T_camera_world.ndim == 3:
            poses = camera.T_camera_world[: truth.frames]
            camera = camera.replace(T_camera_world=poses)
        cameras[name] = camera
    return cameras


def _camera(arrays: CameraArrays, truth: Motion) -> Camera:
    """As tensors; one pose has no time axis."""
    poses = arrays.T_camera_world
    if poses is not None and len(poses) == 1:
        poses = poses[0]
    return Camera.create(
        torch.from_numpy(arrays.camera_matrix),
        arrays.image_size,
        None if arrays.distortion is None else torch.from_numpy(arrays.distortion),
        None if poses is None else torch.from_numpy(poses),
    ).to(dtype=truth.translation.dtype)


def _heading(truth: Motion) -> float:
    """Where the body faces most of the time, radians from the world's x axis."""
    x, y, _ = truth.rotations[:, 0, :, 2].mean(0).tolist()
    return math.atan2(y, x)


def _lost(file: KeypointsFile | PointsFile) -> KeypointsFile | PointsFile:
    """The same from a camera that does not know where it stands, and where it really stood.

    Raises:
        ValueError: when the camera moves.
    """
    camera = file.camera
    assert camera is not None
    assert camera.T_camera_world is not None
    if len(camera.T_camera_world) != 1:
        raise ValueError(
            "a moving camera must know its poses; leave --orbit or --unknown-ground out"
        )
    true = np.linalg.inv(camera.T_camera_world[0])
    if isinstance(file, PointsFile):
        return replace(without_pose(file), truth_T_world_camera=true)
    lost = replace(camera, T_camera_world=None)
    return replace(file, camera=lost, truth_T_world_camera=true)
