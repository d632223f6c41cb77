"""Silhouettes of a person per frame: keypoints outside are hidden by something and not believed.

A mask is true, or not zero, where the person is seen, as segmentation tools write it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from recon.core.errors import ObservationError
from recon.formats.files.json_files import frame_numbers
from recon.formats.files.png_files import read_png
from recon.formats.masks import PackedMask, read_packed_masks
from recon.formats.observations import KeypointsFile

MARGIN = 8
"""Pixels by which a silhouette is widened: joints lie inside, ears and toes at the rim."""


@dataclass(frozen=True)
class Silhouettes:
    """Masks of one view, by frame number."""

    name: str
    images: Mapping[int, Path | PackedMask]
    """Image files, read when needed, or arrays of one bit per pixel."""

    def visible(self, frame: int) -> Bool[np.ndarray, "height width"] | None:
        """The pixels in which the person is seen; None for a frame without a mask.

        Raises:
            ValueError: when the image is damaged.
        """
        found = self.images.get(frame)
        if isinstance(found, PackedMask):
            return found.unpacked()
        if found is None:
            return None
        image = read_png(found)
        if image.ndim == 3:
            image = image[..., :3].max(-1)
        return image != 0


def load_silhouettes(path: str | Path) -> Silhouettes:
    """Masks from a folder of .png files numbered by frame, or an .npz file with `mask (T, H, W)`.

    Raises:
        FileNotFoundError: when there is nothing there.
        ValueError: when there are no images, their names do not number them, or the array is no
            mask.
    """
    path = Path(path)
    if path.is_dir():
        files = sorted(one for one in path.iterdir() if one.suffix.lower() == ".png")
        if len(files) == 0:
            raise ObservationError(f"{path}: expected one .png mask per frame, found none")
        numbers = frame_numbers([one.stem for one in files], str(path))
        return Silhouettes(str(path), dict(zip(numbers, files, strict=True)))
    return Silhouettes(str(path), dict(enumerate(read_packed_masks(path))))


def masked(file: KeypointsFile, masks: Silhouettes, *, first_frame: int = 0) -> KeypointsFile:
    """The observation without the keypoints that fall outside the silhouette of their frame.

    A silhouette is widened by `MARGIN` pixels. Keypoints outside the image go too; frames
    without a mask stay as they are; an empty mask hides the whole person.

    Args:
        file: 2D keypoints of the view.
        masks: of the same view, in its size.
        first_frame: frame number of the observation's first frame.

    Raises:
        ValueError: when no mask belongs to a frame of the observation, or the sizes differ.
    """
    import cv2

    frames = range(first_frame, first_frame + len(file.confidence))
    if not any(frame in masks.images for frame in frames):
        raise ObservationError(
            f"{masks.name}: no mask is of a frame from {frames[0]} to {frames[-1]}; masks are "
            f"numbered from {min(masks.images)} to {max(masks.images)}"
        )
    width, height = file.camera.image_size
    kernel = np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)
    confidence = file.confidence.copy()
    for t, frame in enumerate(frames):
        visible = masks.visible(frame)
        if visible is None:
            continue
        if visible.shape != (height, width):
            raise ObservationError(
                f"{masks.name}, frame {frame}: expected a mask of {width} x {height} pixels, got "
                f"{visible.shape[1]} x {visible.shape[0]}"
            )
        wide = cv2.dilate(visible.astype(np.uint8), kernel) != 0
        column, row = np.floor(file.pixels[t]).astype(np.int64).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        seen = wide[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        confidence[t, ~(inside & seen)] = 0.0
    pixels = np.where(confidence[..., None] > 0, file.pixels, 0.0)
    return replace(file, pixels=pixels, confidence=confidence)
