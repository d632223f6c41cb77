"""What a fit says of a focal length that nobody measured."""

from observations.together import kinds
from recon.diagnosis.findings import Finding
from recon.fitting.clip import ClipFit

_LEAST, _MOST = 0.5, 2.0
"""Factors by which a found focal length may be off the guessed one; beyond them, one is wrong."""


def lens_finding(name: str, found: ClipFit) -> Finding | None:
    """The focal length of the one camera that nobody calibrated; None where all are known.

    Args:
        name: of the camera, for the message.
        found: the fit of one clip.
    """
    lens = found.result.estimate.scene.lens
    if not found.lens_found or lens is None:
        return None
    (view,) = kinds.views(found.observations)
    factor = float(lens.factor[0])
    focal = float(view.camera.camera_matrix[0, ..., 0, 0].mean())
    message = (
        f"{name}: the focal length was guessed as {focal / factor:.0f} pixels and found with the "
        f"motion as {focal:.0f} pixels; poses depend on it little, the distance of the camera as "
        "much as it is wrong. Give a calibration (--camera) where distances matter"
    )
    return Finding("focal", message, value=focal)


def lens_doubtful(found: ClipFit) -> bool:
    """Whether the focal length that was found is none of a phone's main camera."""
    lens = found.result.estimate.scene.lens
    return lens is not None and not _LEAST < float(lens.factor[0]) < _MOST
