"""A camera that nobody calibrated, guessed: its focal length from the size of its images.

Main cameras of phones have focal lengths of 24 to 28 mm for 35 mm film (36 x 24 mm, a diagonal of
43.27 mm); films are cut out of the sensor, the more the steadier they are.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from recon.formats.observations import CameraArrays

FILM_DIAGONAL = 43.27
"""Millimetres; the diagonal of 35 mm film."""
PHONE = 28.0
"""Focal length for 35 mm film of a phone's main camera that films, millimetres: a diagonal field
of view of 75 degrees."""
USUAL_SIZES = ((640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160), (7680, 4320))
"""Widths and heights of films, pixels."""


def guessed_camera(image_size: tuple[int, int]) -> CameraArrays:
    """A phone's camera with images of this size: 75 degrees across, its centre in the middle.

    Its focal length is marked as not known, so that a fit corrects it.
    """
    width, height = image_size
    focal = PHONE / FILM_DIAGONAL * float(np.hypot(width, height))
    matrix = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return CameraArrays(matrix, (int(width), int(height)), focal_known=False)


def guessed_size(
    pixels: Float[np.ndarray, "detections points 2"],
    confidence: Float[np.ndarray, "detections points"],
    sizes: Sequence[tuple[int, int]] = USUAL_SIZES,
) -> tuple[int, int]:
    """The smallest usual size of a film, lying or upright, that holds the keypoints.

    One keypoint in a hundred may lie outside, as detectors guess what the image cuts off. Larger
    ones than all are taken as they are.
    """
    seen = pixels[confidence > 0]
    reach = np.quantile(seen, 0.99, axis=0) if len(seen) > 0 else np.zeros(2)
    for long, short in sizes:
        for size in ((long, short), (short, long)):
            if (reach <= size).all():
                return size
    width, height = np.ceil(reach).astype(int).tolist()
    return width, height
