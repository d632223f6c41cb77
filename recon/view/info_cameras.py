"""Describes detections, calibrations, scans and depth images for `recon info`."""

from pathlib import Path
from typing import Any

import numpy as np

from recon.core.clouds import unit_of_clouds, up_of_clouds
from recon.core.units import METRES
from recon.detections.reader import read_keypoints
from recon.formats.calibration import load_cameras
from recon.formats.cameras import guessed_camera
from recon.formats.depth_images import read_png
from recon.formats.observations import CameraArrays
from recon.formats.opening import files_of
from recon.formats.scan_times import in_time_order
from recon.formats.scans import cloud_files, naturally_sorted, read_cloud, scan_paths
from recon.reading.places import files_of_views, view_name
from recon.reading.tracks import tracks_of_people

_CALIBRATIONS = {".toml", ".yml", ".yaml"}
_SEARCHED_FRAMES = 2_000
"""Most frames of a film in which cuts are searched; more would take more than half a minute."""
_SAMPLED_CLOUDS = 5
"""Number of clouds of a folder that are read to find unit and up axis."""


def describe_folder(path: Path) -> dict[str, Any]:
    """Describe what a folder holds, by the suffixes of its files.

    Raises:
        ValueError: when it holds nothing that recon reads, or something damaged.
    """
    endings = {one.suffix.lower() for one in files_of(path)}
    if cloud_files(path):
        return _describe_scans(path)
    if ".png" in endings:
        return _describe_images(path)
    views, notes = [], ()
    try:
        views, notes = files_of_views([path])
    except ValueError as error:
        if endings & _CALIBRATIONS:
            return describe_calibration(path)
        if not endings and any(path.iterdir()):  # what its folders hold tells more
            raise
        raise ValueError(
            f"{path}: expected a folder of 2D keypoints (.json, .csv, or folders of them), scans "
            f"(.ply, .pcd, .obj, .xyz), depth images or masks (.png), or a calibration; it has "
            f"{', '.join(sorted(endings)) or 'no files'}"
        ) from error
    if views == [path]:
        return describe_detections(path)
    found = {view_name(view): describe_detections(view) for view in views}
    return {
        "format": f"2D keypoints of {len(views)} views",
        **{
            name: f"{one['frames']} frames, {one['layout']}, {'; '.join(one['people'])}"
            for name, one in found.items()
        },
        "units": "pixels",
        "fps": None,
        "decisions": [
            *notes,
            *(f"{n}: {d}" for n, one in found.items() for d in one["decisions"]),
        ],
    }


def describe_detections(path: Path) -> dict[str, Any]:
    """Describe the 2D keypoints of one view and the people in it.

    Raises:
        FileNotFoundError, ValueError: as `read_keypoints` does.
    """
    # any size of images serves, since it does not affect what is described
    found = read_keypoints(path, image_size=(1, 1))
    people = tracks_of_people(found)
    first, last = int(found.frame_numbers[0]), int(found.frame_numbers[-1])
    return {
        "format": "2D keypoints of one view",
        "frames": len(found.frame_numbers),
        "frame_numbers": [first, last],
        "layout": found.layout,
        "points": found.pixels.shape[1],
        "people": [str(track) for track in people],
        "missing": float((found.confidence <= 0).mean()),
        "units": "pixels",
        "fps": found.frame_rate,
        "decisions": list(found.decisions),
    }


def describe_film(path: Path) -> dict[str, Any]:
    """Describe a film's rate, size, lens and, where it is short, cuts; people are not detected.

    Raises:
        FileNotFoundError, ValueError: as `recon.films.decoding.open_film` does.
    """
    from recon.films.decoding import open_film  # imported only for films: loads a decoder

    film = open_film(path)
    shots = "not looked for in a film so long"
    if film.frames <= _SEARCHED_FRAMES:
        sum(1 for _ in film)
        shots = ", ".join(f"{start / film.frame_rate:.2f} s" for start in (0, *film.shots))
    width, height = film.image_size
    return {
        "format": "film",
        "frames": film.frames,
        "fps": film.frame_rate,
        "seconds": film.frames / film.frame_rate,
        "image_size": f"{width} x {height}",
        "turned_by": film.turned_by,
        "lens": _describe_lens(film.image_size, film.stated_focal),
        "shots_from": shots,
        "decisions": list(film.notes),
    }


def _describe_lens(image_size: tuple[int, int], stated: float | None) -> str:
    """Describe the focal length with which the fit of an uncalibrated film begins, and why."""
    camera = guessed_camera(image_size, stated)
    why = "of a usual phone, as the file states none" if stated is None else "as the file states"
    return (
        f"focal length {camera.camera_matrix[0, 0]:.0f} pixels, {why}: "
        f"believed within {camera.focal_std:.0%}"
    )


def describe_calibration(path: Path) -> dict[str, Any]:
    """Describe the cameras of a calibration, their positions and the unit.

    Raises:
        FileNotFoundError, ValueError: as `load_cameras` does.
    """
    found = load_cameras(path)
    return {
        "format": "calibration",
        "cameras": list(found.cameras),
        **{f"camera {name}": _describe_camera(camera) for name, camera in found.cameras.items()},
        "unit": found.unit,
        "decisions": list(found.decisions),
    }


def _describe_camera(camera: CameraArrays) -> str:
    width, height = camera.image_size
    focal = f"focal length {camera.camera_matrix[0, 0]:.0f} pixels"
    lens = "no distortion" if camera.distortion is None else "with distortion"
    poses = camera.T_camera_world
    place = "no pose"
    if poses is not None:
        x, y, z = (
            np.round(-poses[0, :3, :3].T @ poses[0, :3, 3], 2) + 0.0
        )  # adding 0.0 turns -0.0 into 0.0
        moving = "" if len(poses) == 1 else f", moving, {len(poses)} poses"
        place = f"at ({x:.2f}, {y:.2f}, {z:.2f}) m{moving}"
    return f"{width} x {height}, {focal}, {lens}, {place}"


def _describe_scans(path: Path) -> dict[str, Any]:
    paths = scan_paths(path)
    times, fps, decisions = path / "times.csv", None, list[str]()
    if times.exists():
        clock = in_time_order(times, paths)
        fps, decisions = clock.fps, clock.decisions
    else:
        decisions.append("no times.csv: give --frame-rate to fit")
    step = max(len(paths) // _SAMPLED_CLOUDS, 1)
    clouds = [read_cloud(one) for one in paths[::step][:_SAMPLED_CLOUDS]]
    try:
        unit = unit_of_clouds(clouds, str(path))
    except ValueError as error:
        unit = None
        decisions.append(str(error))
    else:
        decisions.append(f"unit {unit}: by the size of the clouds")
        try:
            scaled = [cloud * METRES[unit] for cloud in clouds]
            decisions += up_of_clouds(scaled, str(path), unit_given=False)[1] or ("up axis z",)
        except ValueError as error:
            decisions.append(str(error))
    return {
        "format": f"scans ({paths[0].suffix.lower()})",
        "frames": len(paths),
        "fps": fps,
        "points": int(np.median([len(cloud) for cloud in clouds])),
        "units": unit,
        "decisions": decisions,
    }


def _describe_images(path: Path) -> dict[str, Any]:
    """Describe a folder of images as depth images or masks, by the first image."""
    paths = naturally_sorted(files_of(path, (".png",)))
    image = read_png(paths[0])
    size = {"frames": len(paths), "fps": None, "image_size": [image.shape[1], image.shape[0]]}
    if image.dtype != np.uint16:
        return {"format": "images of 8 bits: masks at best", **size}
    note = "taken for millimetres; fit needs --camera and --frame-rate"
    seen = image[image > 0]
    middle = float(np.median(seen)) if len(seen) > 0 else None
    return {"format": "depth images", **size, "median_of_first": middle, "decisions": [note]}
