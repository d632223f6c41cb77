"""What a fitted person says about the input: distance, size, soles, mirrored images; in words."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from observations import kinds
from observations.camera_paths import tell_distance, triangulate
from observations.first_guess import one_clock
from observations.keypoints2d import Keypoints2D
from recon.body.identities import ODDEST, SHORTEST_BODY, TALLEST_BODY, height
from recon.body.model import BodyModel
from recon.diagnosis.findings import Finding
from recon.fitting.clip import ClipFit
from recon.fitting.ground import sole_heights
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate

_MIN_FILMED_M, _MAX_FILMED_M = 0.7, 40.0
"""Metres at which people are filmed."""
_ODDEST, _ODDEST_MARKERS = 1.5 * ODDEST, 15.0
"""Standard deviations of shape beyond which a fit is no person's. Noise and acrobatics add to what
people differ by, and real markers stand off the skin or beside the landmark that they are named
after: good recordings reach 14. Wrong units and scales are told by the height."""
_SHORTEST_CHILD = 0.95
"""Metres; smaller children do not walk on command."""
_OFF_GROUND = 0.15
"""Metres between the soles that stand and the ground."""
_MAX_MIRRORED_RATIO = 0.6
"""Mirrored images must fit together with less than this share of the error."""
_LEAST_PIXELS = 1.0
"""Errors below this tell nothing."""


def distance_warnings(name: str, seen: Keypoints2D, estimate: Estimate) -> list[Finding]:
    """A wrong focal length moves a body to where nobody films, or off a ground that is known."""
    pelvis = estimate.scene.to_recording(estimate.body.joints[..., :1, :])
    distance = float(seen.camera.to_camera(pelvis.mean(-3, keepdim=True))[..., 2].median())
    if _MIN_FILMED_M < distance < _MAX_FILMED_M:
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
    if given < _LEAST_PIXELS or mirrored > _MAX_MIRRORED_RATIO * given:
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


_MIN_FOCAL_RATIO, _MAX_FOCAL_RATIO = 0.5, 2.0
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
    return lens is not None and not _MIN_FOCAL_RATIO < float(lens.factor[0]) < _MAX_FOCAL_RATIO


_STEP = 0.01
_TELLING = frozenset({"height", "known shape"})
"""Terms by which a caller tells how large the person is."""


def size_is_unknown(found: ClipFit) -> bool:
    """Whether nothing but images of one place, without a ground, tells how large the person is.

    Perspective alone would, if bodies and detections were exact; they are not.
    """
    views = kinds.views(found.observations)
    if found.ground_known or len(views) == 0 or len(views) < len(found.observations):
        return False
    stages = [report.stage for report in found.result.reports]
    told = any(term.name in _TELLING for stage in stages for term in stage.terms)
    if told or not any("shape" in stage.free for stage in stages):
        return False
    alike = one_clock(views)
    return len(alike) == 1 or not tell_distance(alike)


def with_unknown_size(deviations: Deviations, found: ClipFit) -> Deviations:
    """Deviations of a person who may be larger or smaller, as people are, and farther or nearer.

    Everything is scaled about the camera by a factor whose standard deviation is that of people's
    heights.
    """
    estimate = found.result.estimate
    body = estimate.body.model.to(dtype=torch.float64)
    along = _height_direction(body, estimate.motion.shape[0].detach().double())
    tall = float(height(body, estimate.motion.shape[0].detach().double()))
    factor = float(along.norm()) / tall
    camera = kinds.views(found.observations)[0].camera
    eye = camera.T_world_camera[0].reshape(-1, 4, 4)[:, :3, 3].mean(0)
    joints = estimate.scene.to_recording(estimate.body.joints)[0].detach()
    distance = (joints - eye).norm(dim=-1).to(deviations.joints)
    ground = deviations.ground
    if ground is not None:
        above = float((found.T_world_recording[0].to(eye) @ torch.cat((eye, eye.new_ones(1))))[2])
        spread = (ground.height**2 + (factor * above) ** 2) ** 0.5
        ground = replace(ground, height=spread)
    shape = (along / along.norm()).to(deviations.shape)
    return replace(
        deviations,
        # one of three axes, whichever it is, points along the ray
        joints=(deviations.joints.square() + (factor * distance).square() / 3).sqrt(),
        shape=(deviations.shape.square() + shape.square()).sqrt(),
        ground=ground,
    )


def _height_direction(body: BodyModel, shape: Float[Tensor, " shape"]) -> Float[Tensor, " shape"]:
    """Metres that a standard deviation of every coefficient adds to the height."""
    steps = shape + _STEP * torch.eye(len(shape)).to(shape)
    return torch.stack([(height(body, one) - height(body, shape)) / _STEP for one in steps])
