"""PNG images, refused before they are unpacked when they are larger than they should be."""

import struct
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, IMAGE
from recon.formats.files.opening import existing

_HEAD = struct.Struct(">8s4x4sII")
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_png(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """The pixels of an image as they are: (height, width), or (height, width, channels).

    Args:
        path: of the .png file.
        size: width and height that it must have, None for any.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, no PNG image, too large, or of another size.
    """
    # imported here: it is slow to load
    import cv2

    BINARY.check(existing(path).stat().st_size, path)
    data = path.read_bytes()
    if len(data) < _HEAD.size or not data.startswith(_SIGNATURE):
        raise FormatError(f"{path}: expected a PNG image, but it is damaged or something else")
    _, name, width, height = _HEAD.unpack_from(data)
    if name != b"IHDR" or width == 0 or height == 0:
        raise FormatError(f"{path}: expected a PNG image, but its header is damaged")
    IMAGE.check(width * height, path, "header")
    if size is not None and (width, height) != size:
        raise FormatError(
            f"{path}: the camera has images of {size[0]} x {size[1]}, this one is {width} x "
            f"{height} pixels; give its own intrinsics"
        )
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise FormatError(f"{path}: expected a PNG image, but it is damaged")
    return np.asarray(image)
