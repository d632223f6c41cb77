"""Reads films and other detections that state their frame rate and the size of their images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.core.errors import ObservationError
from recon.detections.reader import read_keypoints
from recon.detections.records import Detections
from recon.fitting.settings import ReadOptions
from recon.formats.cameras import CameraArrays
from recon.formats.producers import is_film

_DRIFT = 1.0
"""Frames by which views of nearly one frame rate may drift apart."""
_SAME_FORM, _CUT = 0.002, 0.05
"""Difference of the ratios of width and height up to which images were scaled, and share of a side
that may have been cut off."""


def with_image_size(path: Path, how: ReadOptions) -> Detections | None:
    """Detections in a film or a file that states the size of its images; None for other files."""
    if is_film(path):
        from recon.films.reader import read_film  # its networks and decoders are needed here only

        return read_film(
            path, frame_rate=how.frame_rate, layout=how.layout, detector=how.detector,
            kept=None if how.detections is None else Path(how.detections),
        )  # fmt: skip
    found = read_keypoints(path, layout=how.layout) if path.suffix.lower() == ".npz" else None
    return None if found is None or found.image_size is None else found


def stated_rate(paths: Sequence[Path], known: Mapping[Path, Detections]) -> float | None:
    """The frame rate that all views state; None where one states none.

    Raises:
        ValueError: when they state different ones.
    """
    rates = {path: known[path].frame_rate if path in known else None for path in paths}
    stated = [rate for rate in rates.values() if rate is not None]
    if len(stated) < len(rates):
        return None
    frames = max(int(one.frame_numbers[-1]) + 1 for one in known.values())
    if (max(stated) / min(stated) - 1) * frames > _DRIFT:
        said = ", ".join(f"{path.name} {rate:.6g}" for path, rate in rates.items())
        raise ObservationError(
            f"expected views of one frame rate, got frames per second of {said}; convert "
            "the films to one rate"
        )
    return float(np.mean(stated))


def in_size_of(found: Detections, camera: CameraArrays) -> tuple[Detections, str]:
    """Detections in the pixels of a calibration, and a note where its images have another size.

    Images of the same form were scaled; others are taken as cut at their right and lower border.

    Raises:
        ValueError: when they are turned, or too different to be of this camera.
    """
    size, expected = found.image_size, camera.image_size
    if size is None or tuple(size) == tuple(expected):
        return found, ""
    ratio = np.array(expected) / size
    said = (
        f"{found.name}: images of {size[0]} x {size[1]} pixels, the calibration's have "
        f"{expected[0]} x {expected[1]}"
    )
    if np.ptp(ratio) < _SAME_FORM:
        scaled = (found.pixels + 0.5) * ratio - 0.5
        pixels = np.where((found.confidence > 0)[..., None], scaled, 0.0)
        return replace(found, pixels=pixels, image_size=expected), f"{said}: scaled"
    if np.abs(ratio - 1).max() > _CUT:
        raise ObservationError(f"{said}; give the calibration of this film")
    return found, f"{said}: taken as cut at the right and below"
