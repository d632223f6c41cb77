"""Masks of all frames from one .npz file, kept as one bit per pixel."""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8

from recon.core.errors import FormatError
from recon.core.limits import IMAGE, MASKS
from recon.formats.opening import DAMAGE, check_sizes, existing_file

_KEY = "mask"


@dataclass(frozen=True)
class PackedMask:
    """One mask."""

    bits: UInt8[np.ndarray, " bytes"]
    """Rows after each other, eight pixels in a byte."""
    shape: tuple[int, int]
    """Height and width, pixels."""

    def unpacked(self) -> Bool[np.ndarray, "height width"]:
        """Return the mask as booleans, true where the person is seen."""
        count = self.shape[0] * self.shape[1]
        return np.unpackbits(self.bits, count=count).view(np.bool_).reshape(self.shape)


def read_packed_masks(path: Path) -> list[PackedMask]:
    """The array `mask` (frames, height, width) of an .npz file; the person is where it is not 0.

    Frames are unpacked one by one: a minute of video is as large as the memory of a computer.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, too large or holds no mask.
    """
    existing_file(path)
    try:
        check_sizes(path, MASKS, (_KEY,))
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            if f"{_KEY}.npy" not in names:
                raise FormatError(f"the file holds only {', '.join(names)[:200]}")
            return _masks_of_array(archive, path)
    except DAMAGE as error:
        raise FormatError(
            f"{path}: expected an .npz file with mask of shape (frames, height, width), true or "
            f"whole numbers, but {error}"
        ) from error


def _masks_of_array(archive: zipfile.ZipFile, path: Path) -> list[PackedMask]:
    masks: list[PackedMask] = []
    with archive.open(f"{_KEY}.npy") as member:
        version = np.lib.format.read_magic(member)
        read = np.lib.format.read_array_header_1_0
        if version == (2, 0):
            read = np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(member)
        if len(shape) != 3 or dtype.kind not in "bui" or fortran or shape[0] == 0:
            raise FormatError(f"got {dtype} {shape}" + ", stored column by column" * fortran)
        height, width = shape[1:]
        IMAGE.check(height * width * dtype.itemsize, path, _KEY)
        for _ in range(shape[0]):
            image = np.frombuffer(member.read(height * width * dtype.itemsize), dtype)
            masks.append(PackedMask(np.packbits(image != 0), (height, width)))
    return masks
