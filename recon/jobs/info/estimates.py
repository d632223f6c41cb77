"""What a file of estimated body parameters holds."""

from pathlib import Path
from typing import Any

from recon.formats.estimates import read_estimate


def describe_estimate(path: Path) -> dict[str, Any]:
    """The person of most frames, as `recon refine` takes them; plain values.

    Raises:
        ValueError: when the file holds no such parameters.
    """
    found = read_estimate(path)
    sign, axis = found.up
    return {
        "format": "per-frame SMPL parameters (for `recon refine`)",
        "frames": len(found.translation),
        "frames_without_person": int((~found.known).sum()),
        "fps": found.fps,
        "shape_coefficients": len(found.betas),
        "up": f"{'-' if sign < 0 else ''}{axis}",
        "units": "metres",
        "decisions": list(found.notes),
    }
