"""What a fitted person says about cameras: their distance, mirrored images, focal length, size."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from observations.camera_paths import tell_distance, triangulate
from observations.first_guess import one_clock
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.diagnosis.findings import Finding
from recon.fitting.fitted import ClipFit
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate
from recon.method.sensor import views_of

_NEAR, _FAR = 0.7, 40.0
"""Metres at which people are filmed."""
_CLEARLY = 0.6
"""Mirrored images must fit together with less than this share of the error."""
_LEAST_PIXELS = 1.0
"""Errors below this tell nothing."""


def distance_warnings(name: str, seen: Keypoints2D, estimate: Estimate) -> list[Finding]:
    """A wrong focal length moves a body to where nobody films."""
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
    (view,) = views_of(found.observations)
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


_STEP = 0.01
_TELLING = frozenset({"height", "known shape"})
"""Terms by which a caller tells how large the person is."""


def size_is_unknown(found: ClipFit) -> bool:
    """Whether nothing but images of one place, without a ground, tells how large the person is.

    Perspective alone would, if bodies and detections were exact; they are not.
    """
    views = views_of(found.observations)
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
    tall = float(body.height(estimate.motion.shape[0].detach().double()))
    factor = float(along.norm()) / tall
    camera = views_of(found.observations)[0].camera
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
    return torch.stack([(body.height(one) - body.height(shape)) / _STEP for one in steps])
