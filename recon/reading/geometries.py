"""Open3D geometries as one clip, recognised by their attributes without importing Open3D."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.core.camera import check_camera
from recon.core.clouds import array_of_open3d, cloud_points, up_of_clouds
from recon.core.errors import ObservationError
from recon.core.limits import CLOUD, FRAME_RATE, POSITION
from recon.core.units import to_z_up
from recon.fitting.records import Clip
from recon.fitting.settings import FitSettings
from recon.formats.cameras import CameraArrays
from recon.formats.depth_images import edge_mask
from recon.formats.observations import PointsFile
from recon.formats.scans import POINTS, thinned_cloud
from recon.reading.clip import as_format_errors, clip_of_files

_HEEDED = {"frame_rate", "up", "seed", "robust", "ground"}
"""Options of reading that geometries in memory heed."""


def load_geometries(given: Sequence[Any], settings: FitSettings, body: BodyModel) -> Clip:
    """Make a clip of Open3D clouds, meshes or depth images in metres, one per frame.

    Of meshes, the vertices are taken. Depth images are pairs (image, lens), of one lens with
    `intrinsic_matrix`, `width` and `height` (`open3d.camera.PinholeCameraIntrinsic`), whose pixels
    have their centres at whole numbers.

    Args:
        given: geometries of one kind (`recon.core.arrays.geometries_given`).
        settings: how to read.
        body: that is to be fitted.

    Raises:
        ObservationError: for several kinds, geometries without points, missing options, or options
            that apply to files only; says what to do.
    """
    if others := sorted(set(settings.changed_names()) - _HEEDED):
        raise ObservationError(f"leave out {', '.join(others)}: options of files, not geometries")
    if settings.frame_rate is None:
        raise ObservationError("geometries have no clock: give frame_rate, frames per second")
    pairs = [one for one in given if isinstance(one, tuple)]
    if len(pairs) not in (0, len(given)) or (
        not pairs and any(hasattr(g, "depth") for g in given)
    ):
        raise ObservationError(
            "expected only clouds and meshes, or only pairs (RGBDImage, PinholeCameraIntrinsic)"
        )
    camera = _common_camera([lens for _, lens in pairs]) if pairs else None
    if camera is not None and settings.up is not None:
        raise ObservationError("leave out `up`: depth images have the axes of their camera")
    with as_format_errors():
        FRAME_RATE.check(settings.frame_rate, "geometries", "frame rate")
        clouds = [
            _points_of_geometry(one, k)
            if camera is None
            else _points_of_depth_image(one[0], k, camera)
            for k, one in enumerate(given)
        ]
        CLOUD.check(sum(map(len, clouds)), "geometries", "all together: ")
    generator = np.random.default_rng(settings.seed)
    kept = [thinned_cloud(cloud, POINTS, 3.0, generator) for cloud in clouds]
    if not any(map(len, kept)):
        raise ObservationError("expected points in a geometry, got none in any")
    points, said = np.concatenate(kept), ()
    if camera is None:
        up = settings.up
        if up is None:
            up, said = up_of_clouds(kept, "geometries", unit_given=True)
        points = points @ to_z_up(up).T
    file = PointsFile(
        points=points,
        frame=np.repeat(np.arange(len(kept)), [len(cloud) for cloud in kept]),
        fps=settings.frame_rate,
        camera=camera,
        decisions=said,
    )
    if camera is None:  # ground planes are given in camera axes, so ignore one
        settings = replace(settings, ground=None)
    return clip_of_files([("geometries", file)], (), settings, body)


def _points_of_geometry(geometry: Any, frame: int) -> Float[np.ndarray, "points 3"]:
    found = cloud_points(geometry, f"geometry {frame}")
    POSITION.check(found, f"geometry {frame}", "[point, axis]")
    return found


def _common_camera(lenses: Sequence[Any]) -> CameraArrays:
    matrix = np.array(lenses[0].intrinsic_matrix, dtype=np.float64)
    size = int(lenses[0].width), int(lenses[0].height)
    for one in lenses[1:]:
        if (one.width, one.height) != size or not np.array_equal(one.intrinsic_matrix, matrix):
            raise ObservationError("expected one camera matrix for all depth images, got several")
    check_camera(matrix, size, None, "camera")
    matrix[:2, 2] += 0.5  # in our convention the centre of the first pixel is (0.5, 0.5)
    return CameraArrays(matrix, size)


def _points_of_depth_image(
    image: Any, frame: int, camera: CameraArrays
) -> Float[np.ndarray, "points 3"]:
    """Points of a depth image, camera frame, metres; without edges, which mix two depths."""
    depth = array_of_open3d(
        image.depth.as_tensor() if hasattr(image.depth, "as_tensor") else image.depth
    )
    depth = depth.squeeze(-1) if depth.ndim == 3 and depth.shape[-1] == 1 else depth
    if depth.shape != camera.image_size[::-1]:
        raise ObservationError(
            f"depth image {frame}: expected {camera.image_size[::-1]} rows and columns, as the "
            f"camera has, got {depth.shape}"
        )
    depth = np.nan_to_num(depth, posinf=0.0, neginf=0.0)
    row, column = np.nonzero((depth > 0) & ~edge_mask(depth))
    rays = np.stack([column + 0.5, row + 0.5, np.ones(len(row))], 1)
    cloud = depth[row, column, None] * (rays @ np.linalg.inv(camera.camera_matrix).T)
    POSITION.check(cloud, f"depth image {frame}: expected metres", "[point, axis]")
    return cloud
