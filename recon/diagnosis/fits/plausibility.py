"""What a fitted person says about the input: distance, size, soles, mirrored images; in words."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from observations.keypoints2d import Keypoints2D
from observations.together import kinds
from observations.together.first_guess import one_clock
from observations.together.triangulation import triangulate
from recon.body.identities import ODDEST, SHORTEST_BODY, TALLEST_BODY, height
from recon.diagnosis.findings import Finding
from recon.fitting.clip import ClipFit
from recon.fitting.ground import sole_heights
from recon.method.protocols import Estimate

_NEAR, _FAR = 0.7, 40.0
"""Metres at which people are filmed."""
_ODDEST, _ODDEST_MARKERS = 1.5 * ODDEST, 15.0
"""Standard deviations of shape beyond which a fit is no person's. Noise and acrobatics add to what
people differ by, and real markers stand off the skin or beside the landmark that they are named
after: good recordings reach 14. Wrong units and scales are told by the height."""
_SHORTEST_CHILD = 0.95
"""Metres; smaller children do not walk on command."""
_OFF_GROUND = 0.15
"""Metres between the soles that stand and the ground."""
_CLEARLY = 0.6
"""Mirrored images must fit together with less than this share of the error."""
_LEAST_PIXELS = 1.0
"""Errors below this tell nothing."""


def distance_warnings(name: str, seen: Keypoints2D, estimate: Estimate) -> list[Finding]:
    """A wrong focal length moves a body to where nobody films, or off a ground that is known."""
    pelvis = estimate.scene.to_recording(estimate.body.joints[..., :1, :])
    distance = float(seen.camera.to_camera(pelvis.mean(-3, keepdim=True))[..., 2].median())
    if _NEAR < distance < _FAR:
        return []
    return [
        Finding(
            "distance",
            f"{name}: the person would be {distance:.1f} m from the camera; check the focal "
            "length and that the calibration is in metres",
            value=distance,
        )
    ]


def body_warnings(found: ClipFit) -> list[Finding]:
    """Wrong focal lengths, units and poses of cameras make nobody's body, or one that floats.

    Where no camera and no ground tells sizes, the prior does, and nothing can be said.
    """
    posed = found.result.estimate.body
    tall = float(height(posed.model, posed.shape.detach()).mean())
    warnings: list[Finding] = []
    if not SHORTEST_BODY < tall < TALLEST_BODY and not _is_child(found, tall):
        warnings.append(
            Finding(
                "body size",
                f"the person would be {tall:.2f} m tall; check {_sizes(found)} (for a child this "
                "is as well as an adult body can do)",
                value=tall,
            )
        )
    elif (odd := float(posed.shape.abs().max())) > _oddest(found):
        warnings.append(
            Finding(
                "body size",
                f"the person's shape is {odd:.1f} standard deviations from the average; check "
                f"{_sizes(found)}",
                value=odd,
            )
        )
    if found.ground_known:
        soles = float(sole_heights(found.result.motion, posed.model).median())
        if abs(soles) > _OFF_GROUND:
            warnings.append(
                Finding(
                    "floor",
                    f"the soles stand at {soles:.2f} m, but the ground is at 0; check focal "
                    "lengths, image sizes and the heights of the cameras, unless the person "
                    "stands or sits on something",
                    value=soles,
                )
            )
    return warnings


def child_findings(found: ClipFit) -> list[Finding]:
    """Points in metres that a small body fits show a child, which is no fault of the data."""
    posed = found.result.estimate.body
    tall = float(height(posed.model, posed.shape.detach()).mean())
    if not _is_child(found, tall):
        return []
    return [
        Finding(
            "body size",
            f"the person is {tall:.2f} m tall: a child, whose proportions an adult body meets "
            "only roughly. If it is an adult, check the unit and the scale of the points",
            value=tall,
        )
    ]


def _is_child(found: ClipFit, tall: float) -> bool:
    """Whether points that are measured in metres show somebody as small as children are."""
    return not kinds.views(found.observations) and _SHORTEST_CHILD < tall <= SHORTEST_BODY


def _sizes(found: ClipFit) -> str:
    """What tells the size of a body, for messages."""
    if kinds.views(found.observations):
        return "focal lengths, units and the poses of the cameras"
    return "the unit, the scale and the labels of the points"


def _oddest(found: ClipFit) -> float:
    """Standard deviations from which on a shape is odd; markers beside the skin bend it."""
    return _ODDEST_MARKERS if kinds.markers(found.observations) else _ODDEST


def mirror_warnings(views: Sequence[Keypoints2D]) -> list[Finding]:
    """Images that fit together better when mirrored, as front cameras of phones write them.

    One view alone cannot tell: it shows what the mirrored person would have done.
    """
    alike = one_clock(views)
    if len(alike) < 2:
        return []
    given, mirrored = views_error(alike), views_error([_mirrored(view) for view in alike])
    if given < _LEAST_PIXELS or mirrored > _CLEARLY * given:
        return []
    return [
        Finding(
            "mirrored",
            f"the images seem to be mirrored: their rays miss each other by {given:.1f} pixels, "
            f"and by {mirrored:.1f} when left and right of all images are exchanged; mirror the "
            "videos back before keypoints are detected",
            value=mirrored / given,
        )
    ]


def views_error(views: Sequence[Keypoints2D]) -> float:
    """Median distance of keypoints from their triangulated points in the images, pixels."""
    points, exists = triangulate(views)
    away = [_reprojection(view, points)[exists & (view.confidence > 0)] for view in views]
    together = torch.cat(away)
    return float(together.median()) if len(together) > 0 else 0.0


def _reprojection(
    view: Keypoints2D, points: Float[Tensor, "batch moments points 3"]
) -> Float[Tensor, "batch moments points"]:
    return (view.camera.project(points).pixels - view.pixels).norm(dim=-1)


def _mirrored(view: Keypoints2D) -> Keypoints2D:
    """The view with left and right of the image exchanged."""
    turned = view.pixels * view.pixels.new_tensor([-1.0, 1.0])
    return view.replace(pixels=turned + turned.new_tensor([float(view.camera.image_size[0]), 0.0]))
