"""Simulates the observation file of any kind of sensor for a known motion."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np

from recon.body.landmarks import KEYPOINTS_43, LANDMARKS_16
from recon.body.model import BodyModel
from recon.core.camera import depth_camera
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.formats.observations import (
    KeypointsFile,
    ObservationFile,
    PointsFile,
    PositionsFile,
)
from recon.simulation.depth import DepthSensor, PixelSurface, depth_points, without_pose
from recon.simulation.images import cameras_around, keypoints2d, mean_heading
from recon.simulation.points import (
    Corruption,
    joints3d,
    markers3d,
    scan_points,
    visible_joints,
)
from recon.simulation.scenery import FurnitureMesh, clothed, furniture_around
from recon.simulation.settings import (
    FILM_DEFAULTS,
    SURFACE_DEFAULTS,
    FilmSettings,
    FurnitureName,
    LeftOver,
    SensorKind,
    SurfaceSettings,
)


def simulated_files(
    truth: Motion,
    body: BodyModel,
    kind: SensorKind,
    corruption: Corruption,
    seed: int,
    film: FilmSettings = FILM_DEFAULTS,
    surface: SurfaceSettings = SURFACE_DEFAULTS,
    *,
    unknown_ground: bool = False,
) -> dict[str, ObservationFile]:
    """Simulate observations, keyed by camera; sensors without cameras have the key "".

    Args:
        truth: one clip (no batch axis).
        body: whose motion it is.
        kind: what the sensor gives.
        corruption: what stands between the truth and the sensor.
        seed: of everything random.
        film: which cameras look, for keypoints2d and depth.
        surface: what is seen of the surface, for landmarks, depth and scans.
        unknown_ground: leave out where the ground is and where the camera stands.

    Raises:
        FileNotFoundError: when there is no such calibration.
        ReconError: when it is damaged, or options contradict each other.
    """
    refuse_other_options(kind, film, surface, corruption)
    if corruption.during is not None and not bool(corruption.active(truth.times).any()):
        raise ReconError(
            f"during: expected seconds within the motion, which lasts from {truth.start_time:.2f} "
            f"to {truth.stop_time:.2f} s of its own clock, got {corruption.during}"
        )
    if kind in ("keypoints2d", "depth"):
        return _simulated_views(
            truth, body, kind, corruption, seed, film, surface, unknown_ground=unknown_ground
        )
    if kind == "scans":
        if unknown_ground:
            raise ReconError(
                "scans are given in the world, so an unknown ground does not apply to them"
            )
        seen = _clothed_body(body, surface)
        return {"": scan_points(truth, seen, corruption, seed, points=surface.points)}
    known = not unknown_ground
    return {
        "": _simulated_positions(truth, body, kind, corruption, seed, surface, ground_known=known)
    }


def refuse_other_options(
    kind: SensorKind, film: FilmSettings, surface: SurfaceSettings, corruption: Corruption
) -> None:
    """Raise an error for words that are not known, and options that do not apply to this kind."""
    for name, words, known in (
        ("kind", (kind,), get_args(SensorKind)),
        ("furniture", surface.furniture, get_args(FurnitureName)),
        ("left_over", surface.left_over, get_args(LeftOver)),
    ):
        if not set(words) <= set(known):
            raise ReconError(f"{name}: expected words among {', '.join(known)}; got {words!r}")
    if kind not in ("keypoints2d", "depth") and film != FILM_DEFAULTS:
        raise ReconError(f"camera, views, orbit and layout do not apply to {kind}")
    no_furniture = {"furniture": (), "left_over": ()}
    if kind != "depth" and replace(surface, **no_furniture) != surface:
        raise ReconError(f"furniture and left_over are options for depth, not for {kind}")
    if "furniture" in surface.left_over and not surface.furniture:
        raise ReconError(
            "left_over keeps points of furniture, but no furniture was given; give furniture, "
            "or leave left_over out"
        )
    clouds = replace(surface, skin_offset=SURFACE_DEFAULTS.skin_offset, **no_furniture)
    if kind not in ("depth", "scans") and clouds != SURFACE_DEFAULTS:
        raise ReconError(f"points and clothed are options for depth and scans, not for {kind}")
    hides = corruption.hide_below is not None or corruption.hide_box is not None
    if corruption.during is not None and not hides:
        raise ReconError(
            "during: gives the time in which points are hidden, but none are; hide points below a "
            "height or in a box, or leave during out"
        )
    if surface.points < 1:
        raise ReconError(f"points: expected one or more, got {surface.points}")
    if kind != "landmarks" and surface.skin_offset != SURFACE_DEFAULTS.skin_offset:
        raise ReconError(f"a skin offset is an option for landmarks, not for {kind}")


def _clothed_body(body: BodyModel, surface: SurfaceSettings) -> BodyModel:
    return body if surface.clothed is None else clothed(body, surface.clothed)


def _simulated_positions(
    truth: Motion,
    body: BodyModel,
    kind: SensorKind,
    corruption: Corruption,
    seed: int,
    surface: SurfaceSettings,
    *,
    ground_known: bool,
) -> PositionsFile:
    """Simulate joints, markers or landmarks; return the contents of an observation file."""
    if kind == "joints3d":
        seen, names = joints3d(truth, body, corruption, seed), JOINTS
    else:
        are_landmarks = kind == "landmarks"
        names = LANDMARKS_16 if are_landmarks else KEYPOINTS_43
        offset = surface.skin_offset if are_landmarks else 0.0
        seen = markers3d(truth, body, corruption, seed, names, offset)
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


def _simulated_views(
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
    """Simulate one observation per camera, keyed by the camera's name."""
    if kind == "depth" and film.layout != FILM_DEFAULTS.layout:
        raise ReconError("layout is an option for keypoints, not for depth")
    cameras = cameras_around(truth, body, film, depth_camera() if kind == "depth" else None)
    if unknown_ground and len(cameras) > 1:
        raise ReconError(
            f"an unknown ground means cameras without poses, so {len(cameras)} views cannot be "
            "combined; film with one camera, or with a known ground"
        )
    files: dict[str, ObservationFile] = {}
    for k, (name, camera) in enumerate(cameras.items()):
        # with up to 100 views, no two values of --seed give views the same seed
        own = 100 * seed + k
        if kind == "depth":
            quiet, sensor = replace(corruption, noise=0.0), DepthSensor()
            sensor = replace(sensor, constant=math.hypot(sensor.constant, corruption.noise))
            file = depth_points(
                truth, _clothed_body(body, surface), camera, quiet, own,
                sensor=sensor, points=surface.points,
                surfaces=(PixelSurface.BODY, *(_LEFT[name] for name in surface.left_over)),
                furniture=_furniture_around(truth, body, surface),
            )  # fmt: skip
        else:
            file = keypoints2d(truth, body, camera, corruption, own, film.layout)
            if not (file.confidence > 0).any():
                raise ReconError(f"camera {name} sees nothing of the motion in any frame")
        files[name] = _without_camera_pose(file) if unknown_ground else file
    return files


_LEFT = {"ground": PixelSurface.GROUND, "furniture": PixelSurface.FURNITURE}


def _furniture_around(
    truth: Motion, body: BodyModel, surface: SurfaceSettings
) -> FurnitureMesh | None:
    """Place the chosen furniture around a motion's mean position, turned to its mean heading."""
    if len(surface.furniture) == 0:
        return None
    middle = body.pose(truth).joints.flatten(0, -2).mean(0).double().numpy()
    return furniture_around(surface.furniture, middle, mean_heading(truth))


def _without_camera_pose(file: KeypointsFile | PointsFile) -> KeypointsFile | PointsFile:
    """Remove the camera's pose from an observation, and store it as the true pose.

    Raises:
        ValueError: when the camera moves.
    """
    camera = file.camera
    assert camera is not None
    assert camera.T_camera_world is not None
    if len(camera.T_camera_world) != 1:
        raise ReconError(
            "a moving camera needs known poses, and an unknown ground means none; leave orbit "
            "out, or film with a known ground"
        )
    true = np.linalg.inv(camera.T_camera_world[0])
    if isinstance(file, PointsFile):
        return replace(without_pose(file), truth_T_world_camera=true)
    lost = replace(camera, T_camera_world=None)
    return replace(file, camera=lost, truth_T_world_camera=true)
