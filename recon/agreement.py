"""How well a fitted clip agrees with what was seen, and what that says about the input."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from observations.first_guess import Seen
from observations.keypoints2d import Keypoints2D
from recon.clip import ClipFit
from recon.clip_files import Clip
from recon.plausibility import body_warnings, distance_warnings, mirror_warnings
from recon.protocols import Estimate

_SUSPECT = 5.0
"""Times the noise that was told from the data, from which on a median misfit is suspicious."""
_SUSPECT_PIXELS = 15.0
_SUSPECT_METRES = 0.06


def agreement(clip: Clip, found: ClipFit) -> dict[str, Any]:
    """Per observation the median misfit, and warnings in words.

    Pixels for keypoints, metres for points. A misfit far above the noise means that model and
    data contradict each other: mirrored images, swapped views, a wrong focal length or unit.
    """
    estimate = found.result.estimate
    here = Estimate(estimate.decoded, estimate.body, estimate.scene.detach())
    rows, warnings = [], []
    for name, seen, noise in zip(clip.names, found.observations, found.noises, strict=True):
        with torch.no_grad():
            away = misfits(seen, here)
        median = float(away.median()) if len(away) > 0 else None
        unit = "pixels" if isinstance(seen, Keypoints2D) else "metres"
        rows.append({"name": name, "unit": unit, "median": median, "noise": noise.own})
        least = _SUSPECT_PIXELS if unit == "pixels" else _SUSPECT_METRES
        if median is None:
            warnings.append(f"{name}: nothing seen at the times of the motion")
        elif median > max(_SUSPECT * noise.own, least):
            warnings.append(
                f"{name}: the fitted body misses half of the data by more than {median:.3g} "
                f"{unit}, and the data's own noise is {noise.own:.2g}; check calibration, units, "
                "that left and right are not mirrored, and that all files show the same person"
            )
        if isinstance(seen, Keypoints2D):
            warnings += distance_warnings(name, seen, here)
    views = [seen for seen in clip.observations if isinstance(seen, Keypoints2D)]
    warnings += body_warnings(found) + mirror_warnings(views)
    return {"misfits": rows, "warnings": warnings}


def misfits(seen: Seen, estimate: Estimate) -> Float[Tensor, " samples"]:
    """Distance of everything that was seen from the estimate, in its own unit."""
    return seen.residuals(estimate).present()
