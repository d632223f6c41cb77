"""Reads folders of 16-bit depth images, back-projected to point clouds."""

import struct
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt16

from recon.core.camera import Camera
from recon.core.errors import FormatError
from recon.core.limits import BINARY, DEPTH_SCALE, IMAGE
from recon.formats.observations import CameraArrays, PointsFile
from recon.formats.opening import existing_file, files_of
from recon.formats.scan_times import clock_of_files
from recon.formats.scans import POINTS, naturally_sorted, thinned_cloud

_PNG_HEADER = struct.Struct(">8s4x4sIIBB")
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_png(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """Read the unchanged pixels of a PNG image: (height, width), or (height, width, channels).

    Args:
        path: of the .png file.
        size: width and height that it must have, None for any.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, no PNG image, too large, or of another size.
    """
    # imported only when needed, since it loads slowly
    import cv2

    BINARY.check(existing_file(path).stat().st_size, path)
    data = path.read_bytes()
    if len(data) < _PNG_HEADER.size or not data.startswith(_PNG_SIGNATURE):
        raise FormatError(
            f"{path}: expected a PNG image, but the file is damaged or of another format"
        )
    _, name, width, height, bits, colour = _PNG_HEADER.unpack_from(data)
    if name != b"IHDR" or width == 0 or height == 0:
        raise FormatError(f"{path}: expected a PNG image, but its header is damaged")
    # cv2 returns up to four channels of a colour image
    IMAGE.check(width * height * max(bits // 8, 1) * (4 if colour else 1), path, "header")
    if size is not None and (width, height) != size:
        raise FormatError(
            f"{path}: the camera has images of {size[0]} x {size[1]}, this one is {width} x "
            f"{height} pixels; give intrinsics of this size"
        )
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise FormatError(f"{path}: expected a PNG image, but it is damaged")
    return np.asarray(image)


_RANGE = (0.2, 12.0)
"""Nearest and farthest depth at which sensors see people, metres."""
_EDGE = 0.15
"""Difference in depth of neighbouring pixels above which an object's edge runs there, metres."""
_SATURATED = 65535
"""Largest 16-bit number, which many sensors write where they measured nothing."""
_FIRST_LOOK = 3
"""Number of images whose median depths are checked against `_RANGE` before all are read."""


def read_depth_images(
    folder: str | Path,
    camera: CameraArrays,
    *,
    fps: float | None = None,
    depth_scale: float = 0.001,
    masks: str | Path | None = None,
    points: int = POINTS,
    outliers: float | None = 3.0,
    seed: int = 0,
) -> PointsFile:
    """Read depth images as points, in the world if the camera has a pose, else in its frame.

    Pixels at depth edges mix what lies before and behind them and are left out. Pixels of 0 or
    65535 have no depth.

    Args:
        folder: of 16-bit .png files, one per frame. Its times.csv, or the numbers or times in
            their names, give the clock as in `read_scans`: dropped frames stay empty.
        camera: of the depth images, with no pose, one, or one for every image.
        fps: frames per second where there is no times.csv.
        depth_scale: metres per unit of the images; 0.001 where they hold millimetres.
        masks: folder of images with the same names, or in the same order, nonzero on the person.
        points: most points kept of a frame, drawn at random.
        outliers: as in `read_scans`.
        seed: of the draw.

    Raises:
        FileNotFoundError: when a folder is missing.
        ValueError: when there is no image or no point, an image is not of 16 bits or of another
            size than the camera's, or nobody can be seen at such depths.
    """
    folder = Path(folder)
    named = _png_files(folder)
    mask_of = {} if masks is None else _masks_of_images(named, Path(masks))
    clock = clock_of_files(folder, named, fps)
    paths = clock.files
    DEPTH_SCALE.check(depth_scale, folder, "--depth-scale")
    generator = np.random.default_rng(seed)
    poses, lens = camera.T_camera_world, _camera_at_origin(camera)
    if poses is not None and len(poses) not in (1, len(paths)):
        raise FormatError(
            f"{folder}: expected a pose of the camera for each of {len(paths)} images, got "
            f"{len(poses)}"
        )
    saturated, clouds = list[bool](), list[np.ndarray]()

    def depth_and_mask(k: int) -> tuple[np.ndarray, np.ndarray]:
        image = _read_depth_image(paths[k], camera)
        saturated.append(bool((image == _SATURATED).any()))
        depth = np.where(image == _SATURATED, 0, image) * depth_scale
        seen = (depth > 0) & ~edge_mask(depth)
        if (mask_path := mask_of.get(paths[k])) is None:
            return depth, seen
        mask = read_mask(mask_path)
        if mask.shape != depth.shape:
            raise FormatError(
                f"{mask_path}: expected a mask of image size {depth.shape}, got {mask.shape}"
            )
        return depth, seen & mask

    order = (0, len(paths) // 2, len(paths) - 1, *range(len(paths)))
    known = (
        float(np.median(depth[seen])) for depth, seen in map(depth_and_mask, order) if seen.any()
    )
    if not (middles := list(islice(known, _FIRST_LOOK))):
        raise FormatError(
            f"{folder}: no image holds any depth" + (" inside its mask" * bool(masks))
        )
    if not _RANGE[0] <= (middle := float(np.median(middles))) <= _RANGE[1]:
        raise FormatError(
            f"{folder}: with {depth_scale:g} m per unit the middle depth is {middle:.3g} m; "
            f"expected {_RANGE[0]} to {_RANGE[1]} m, so give the sensor's scale with --depth-scale"
        )
    for k in range(len(paths)):
        cloud = thinned_cloud(
            back_projected(*depth_and_mask(k), lens), points, outliers, generator
        )
        if poses is not None:
            T = poses[k % len(poses)]
            cloud = (cloud - T[:3, 3]) @ T[:3, :3]
        clouds.append(cloud)
    said = f"{_SATURATED}, the largest number of 16 bits, is taken as no measurement"
    if poses is not None and len(poses) > 1:
        # an empty frame shows nothing: that of the image before stands for its pose
        image = np.searchsorted(clock.frames, np.arange(clock.frames[-1] + 1), "right") - 1
        camera = replace(camera, T_camera_world=poses[image])
    return PointsFile(
        points=np.concatenate(clouds),
        frame=np.repeat(clock.frames, [len(cloud) for cloud in clouds]),
        fps=clock.fps,
        start_time=clock.start_time,
        camera=camera,
        decisions=(*clock.decisions, *(said,) * any(saturated)),
    )


def back_projected(
    depth: Float[np.ndarray, "height width"],
    seen: Bool[np.ndarray, "height width"],
    camera: Camera,
) -> Float[np.ndarray, "points 3"]:
    """Back-project the centres of pixels with depth to points in the camera's frame, metres.

    The centre of pixel (column, row) has u = column + 0.5, as in `Camera.in_image`.
    """
    row, column = np.nonzero(seen)
    pixels = torch.from_numpy(np.stack([column, row], 1) + 0.5)
    return camera.unproject(pixels, torch.from_numpy(depth[row, column])).numpy()


def edge_mask(depth: Float[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """Return a mask of pixels whose neighbour is farther or nearer by more than 0.15 m."""
    edge = np.zeros(depth.shape, np.bool_)
    for axis in (0, 1):
        pixels, neighbours = (np.moveaxis(depth, axis, 0)[k] for k in (np.s_[:-1], np.s_[1:]))
        jump = (np.abs(pixels - neighbours) > _EDGE) & (pixels > 0) & (neighbours > 0)
        edges = np.moveaxis(edge, axis, 0)
        edges[:-1] |= jump
        edges[1:] |= jump
    return edge


def _camera_at_origin(camera: CameraArrays) -> Camera:
    """Make a `Camera` with the same lens at the origin, so that its frame is the world."""
    distortion = camera.distortion
    return Camera.create(
        torch.from_numpy(np.asarray(camera.camera_matrix, np.float64)),
        camera.image_size,
        None if distortion is None else torch.from_numpy(np.asarray(distortion, np.float64)),
    )


def _png_files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder; expected one of .png images")
    paths = naturally_sorted(files_of(folder, (".png",)))
    if not paths:
        raise FormatError(f"{folder}: expected .png images, one per frame, got none")
    return paths


def _masks_of_images(paths: list[Path], masks: Path) -> dict[Path, Path]:
    found = _png_files(masks)
    named = {path.name: path for path in found}
    if all(path.name in named for path in paths):
        return {path: named[path.name] for path in paths}
    if len(found) != len(paths):
        raise FormatError(f"{masks}: expected {len(paths)} masks, one per image, got {len(found)}")
    return dict(zip(paths, found, strict=True))


def _read_depth_image(path: Path, camera: CameraArrays) -> UInt16[np.ndarray, "height width"]:
    image = read_png(path, camera.image_size)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise FormatError(
            f"{path}: expected a 16-bit grey image of depths, got {image.dtype} {image.shape}"
        )
    return image


def read_mask(path: Path) -> Bool[np.ndarray, "height width"]:
    """Read a mask from a PNG image: true where it is not black, whatever its transparency."""
    image = read_png(path)
    return (image if image.ndim == 2 else image[..., :3].max(-1)) > 0
