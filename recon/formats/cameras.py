"""Checks the camera values that files state, and guesses missing ones."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.core.camera import check_camera, check_pose
from recon.core.errors import FormatError
from recon.core.limits import IMAGE_SIZE

ImageSize = tuple[int, int]
"""Width and height of an image, pixels."""
_COEFFICIENTS = (4, 5, 8)
"""Allowed numbers of distortion coefficients, k1 k2 p1 p2 [k3 [k4 k5 k6]] as in OpenCV."""
FILM_DIAGONAL = 43.27
"""Diagonal of a frame of 35 mm film (36 x 24 mm), millimetres."""
PHONE = 28.0
"""35 mm equivalent focal length of a phone's main camera when it films, millimetres: a diagonal
field of view of 75 degrees."""
GUESSED_FOCAL_STD, STATED_FOCAL_STD = 0.3, 0.1
"""Relative standard deviations of a guessed focal length, and of one in a film's metadata:
stabilising crops a film by 10 to 15 %, and its aspect ratio differs from that of the sensor."""
_ASPECT_TOLERANCE = 0.002
"""Relative difference of the scales of width and height up to which two images have one aspect
ratio; rounding 1920 x 1080 to 426 x 240 makes 0.0016."""
_BLOCK = 16
"""Edge of a block of H.264, pixels: films of 1080 rows are stored with 1088 and then cropped."""
USUAL_SIZES = ((640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160), (7680, 4320))
"""Common widths and heights of films in landscape, pixels, from small to large."""


@dataclass(frozen=True)
class CameraPath:
    """Poses of a moving camera, in the world of a tracker that does not know the ground."""

    T_world_camera: Float[np.ndarray, "time 4 4"]
    """Camera-to-world transform of every frame; translations in the tracker's unit."""
    metric: bool
    """Whether the tracker's unit is the metre."""
    level: bool
    """Whether the z axis of the tracker's world points up."""


@dataclass(frozen=True)
class CameraArrays:
    """A camera as NumPy arrays: intrinsics, distortion and poses, with OpenCV's axes."""

    camera_matrix: Float[np.ndarray, "3 3"]
    """Focal lengths, skew and principal point, pixels."""
    image_size: tuple[int, int]
    """Width and height, pixels."""
    distortion: Float[np.ndarray, " coefficients"] | None = None
    """Lens coefficients k1 k2 p1 p2 [k3 [k4 k5 k6]] in OpenCV's order; None for no distortion."""
    T_camera_world: Float[np.ndarray, "poses 4 4"] | None = None
    """World-to-camera transforms, metres: one, or one per frame. None where they are not known."""
    focal_std: float = 0.0
    """Relative standard deviation of the focal length; 0 if measured. Not saved to files."""
    path: CameraPath | None = None
    """Motion of a camera whose pose in the world is not known. Not saved to files."""

    @property
    def focal_known(self) -> bool:
        """Whether the focal length was measured, and not guessed or read from metadata."""
        return self.focal_std == 0

    @property
    def pose_count(self) -> int:
        """Number of poses: 0 if they are unknown, 1 of a fixed camera, or one per frame."""
        return 0 if self.T_camera_world is None else len(self.T_camera_world)


@dataclass(frozen=True)
class CameraFields:
    """Unchecked values that a file states about one camera; None where it does not state them."""

    name: str
    matrix: Any
    size: Any = None
    """Width and height of the images, pixels."""
    distortion: Any = None
    rotation: Any = None
    """Rotation from world to camera: a Rodrigues vector or a matrix."""
    translation: Any = None
    pose: Any = None
    """World-to-camera matrix (3x4 or 4x4, or one per frame), in place of the two fields above."""


def checked_camera(
    fields: CameraFields, image_size: tuple[int, int] | None, path: Path
) -> CameraArrays:
    """Convert a camera's values to arrays and check them; unit and world stay those of the file.

    Raises:
        ValueError: when values are not numbers, have a wrong shape or a focal length that is not
            positive, a rotation is none, or the image size is neither stated nor given.
    """
    where = f"{path}, camera {fields.name}"
    matrix = _float_array(fields.matrix, "camera matrix", where)
    if matrix.shape != (3, 3):
        raise FormatError(
            f"{where}: expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got "
            f"an array of shape {matrix.shape}"
        )
    size = _checked_image_size(fields.size, image_size, where)
    distortion = _checked_distortion(fields.distortion, where)
    check_camera(matrix, size, distortion, where)
    return CameraArrays(
        camera_matrix=matrix,
        image_size=size,
        distortion=distortion,
        T_camera_world=_checked_poses(fields, where),
    )


def _float_array(value: Any, quantity: str, where: str) -> np.ndarray:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        shown = repr(value)[:80]
        raise FormatError(f"{where}: expected numbers in the {quantity}, got {shown}") from error
    if not np.isfinite(numbers).all():
        raise FormatError(f"{where}: the {quantity} holds NaN or infinity")
    return numbers


def _checked_image_size(stated: Any, given: tuple[int, int] | None, where: str) -> tuple[int, int]:
    if stated is None and given is None:
        raise FormatError(
            f"{where}: the calibration does not state the image size; give it with --image-size "
            "WIDTH HEIGHT"
        )
    size = _float_array(given if stated is None else stated, "image size", where)
    if size.shape != (2,):
        raise FormatError(f"{where}: expected a width and a height in pixels, got {size.tolist()}")
    IMAGE_SIZE.check(size, where, "image size")
    return int(size[0]), int(size[1])


def _checked_distortion(value: Any, where: str) -> np.ndarray | None:
    if value is None:
        return None
    numbers = _float_array(value, "distortion", where).ravel()
    longest = _COEFFICIENTS[-1]
    if len(numbers) > longest and not numbers[longest:].any():
        numbers = numbers[:longest]
    if len(numbers) < _COEFFICIENTS[0]:
        numbers = np.pad(numbers, (0, _COEFFICIENTS[0] - len(numbers)))
    if len(numbers) not in _COEFFICIENTS:
        raise FormatError(
            f"{where}: expected up to 4, or 5 or 8 distortion coefficients (k1 k2 p1 p2 [k3 [k4 "
            f"k5 k6]]), got {len(numbers)}; calibrate without thin prism or tilt"
        )
    return numbers if numbers.any() else None


def _checked_poses(fields: CameraFields, where: str) -> np.ndarray | None:
    if fields.pose is not None:
        pose = _float_array(fields.pose, "pose", where)
        pose = pose[None] if pose.ndim == 2 else pose
        if pose.ndim != 3 or pose.shape[1:] not in ((3, 4), (4, 4)) or len(pose) == 0:
            raise FormatError(f"{where}: expected poses 3 x 4 or 4 x 4, got {pose.shape}")
        rotation, translation = pose[:, :3, :3], pose[:, :3, 3]
    elif fields.rotation is None and fields.translation is None:
        return None
    elif fields.rotation is None or fields.translation is None:
        raise FormatError(f"{where}: expected both rotation and translation, got only one")
    else:
        turn = _float_array(fields.rotation, "rotation", where)
        if turn.size == 3:
            import cv2

            turn = np.asarray(cv2.Rodrigues(turn.reshape(3, 1))[0])
        translation = _float_array(fields.translation, "translation", where).reshape(1, -1)
        if turn.shape != (3, 3) or translation.shape != (1, 3):
            raise FormatError(
                f"{where}: expected a rotation of 3 or 3x3 numbers and a translation of 3, got "
                f"{turn.shape} and {translation.shape}"
            )
        rotation = turn[None]
    out = np.tile(np.eye(4), (len(rotation), 1, 1))
    out[:, :3, :3] = rotation
    # the size of the translation is checked later, when its unit is known
    check_pose(out, where, "rotation from world to camera")
    out[:, :3, 3] = translation
    return out


def scale_of_images(size: ImageSize, other: ImageSize) -> Float[np.ndarray, "2"] | None:
    """Return the scale (x, y) from images of `size` to `other`; None if they are no scaled copies.

    Images of one aspect ratio are copies in another resolution. Where sides differ by less than a
    codec's block, the larger images were padded to whole blocks at the right and below: no pixel
    moves, and the scale is 1. Other differences come from stabilising, or from another mode of
    the camera, which change focal length and principal point.
    """
    scale = np.array(other) / size
    if np.ptp(scale) < _ASPECT_TOLERANCE * scale.max():
        return scale
    return np.ones(2) if np.abs(np.subtract(other, size)).max() < _BLOCK else None


def undistorted_pixels(
    pixels: Float[np.ndarray, "*points 2"], camera: CameraArrays
) -> Float[np.ndarray, "*points 2"]:
    """Undistort pixels: return where the same camera without distortion would see them."""
    if camera.distortion is None or pixels.size == 0:
        return pixels
    import cv2

    flat = cv2.undistortPoints(
        pixels.reshape(-1, 1, 2), camera.camera_matrix, camera.distortion, P=camera.camera_matrix
    )
    return flat.reshape(pixels.shape)


def guessed_camera(image_size: tuple[int, int], stated: float | None = None) -> CameraArrays:
    """Guess a phone's camera from the image size, with the principal point in the middle.

    Its focal length is marked as not known, so that a fit corrects it.

    Args:
        image_size: width and height, pixels.
        stated: 35 mm equivalent focal length in the metadata, millimetres; None takes `PHONE`.
    """
    width, height = image_size
    focal = (stated or PHONE) / FILM_DIAGONAL * float(np.hypot(width, height))
    matrix = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    std = GUESSED_FOCAL_STD if stated is None else STATED_FOCAL_STD
    return CameraArrays(matrix, (int(width), int(height)), focal_std=std)


def guessed_image_size(
    pixels: Float[np.ndarray, "detections points 2"],
    confidence: Float[np.ndarray, "detections points"],
) -> tuple[int, int]:
    """Guess the image size: the smallest usual one, in either orientation, around the keypoints.

    One keypoint in a hundred may lie outside, as detectors guess what the image cuts off. Where
    no usual size is large enough, the extent of the keypoints is taken.
    """
    seen = pixels[confidence > 0]
    reach = np.quantile(seen, 0.99, axis=0) if len(seen) > 0 else np.zeros(2)
    for long, short in USUAL_SIZES:
        for size in ((long, short), (short, long)):
            if (reach <= size).all():
                return size
    width, height = np.ceil(reach).astype(int).tolist()
    return width, height
