"""Warns of wrong cameras, judged by the fitted person: distance, focal length, movement.

People who stand, walk or dance have some part of a foot at rest on the ground most of the time. In
the image of a fixed camera its keypoints then keep their place; in the image of a camera that is
held in the hand, panned with a walker or carried along, nothing ever does. People who run or jump
have no foot at rest most of the time, but rest briefly between their flights.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from observations.camera_paths import views_to_triangulate
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.core.residuals import NORMAL_MAD
from recon.diagnosis.findings import NOTHING, Finding, Findings
from recon.diagnosis.images import Images
from recon.fitting.records import ClipFit
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate
from recon.method.sensor import views_of

_MIN_DISTANCE_M, _MAX_DISTANCE_M = 0.7, 40.0
"""Smallest and largest distance (m) from which people are usually filmed."""


def distance_warnings(name: str, seen: Keypoints2D, estimate: Estimate) -> list[Finding]:
    """Warn of an implausible distance from the camera, which a wrong focal length causes."""
    pelvis = estimate.scene.to_recording(estimate.body.joints[..., :1, :])
    distance = float(seen.camera.to_camera(pelvis.mean(-3, keepdim=True))[..., 2].median())
    if _MIN_DISTANCE_M < distance < _MAX_DISTANCE_M:
        return []
    return [
        Finding(
            "distance",
            f"{name}: the person would be {distance:.1f} m from the camera; check the focal "
            "length and that the calibration is in metres",
            value=distance,
        )
    ]


_MIN_LENS, _MAX_LENS = 0.5, 2.0
"""Smallest and largest plausible ratio of the fitted focal length to the initially assumed one."""


def lens_findings(name: str, found: ClipFit) -> Findings:
    """Return a note of the focal length that was fitted for an uncalibrated camera, if any.

    It is a warning where the value is implausible for the main camera of a phone.

    Args:
        name: name of the camera, for the message.
        found: fit of one clip.
    """
    lens = found.result.estimate.scene.lens
    if not found.lens_found or lens is None:
        return NOTHING
    (view,) = views_of(found.observations)
    factor = float(lens.factor[0])
    focal = float(view.camera.camera_matrix[0, ..., 0, 0].mean())
    message = (
        f"{name}: the focal length was guessed as {focal / factor:.0f} pixels and estimated with "
        f"the motion as {focal:.0f} pixels; poses depend on it little, but the camera's distance "
        "is wrong by the same factor as the focal length. Give a calibration (--camera) where "
        "distances matter"
    )
    said = (Finding("focal", message, value=focal),)
    return Findings(diagnosis=said) if _MIN_LENS < factor < _MAX_LENS else Findings(warnings=said)


_STEP = 0.01
_SIZE_TERMS = frozenset({"height", "known shape"})
"""Names of the terms by which a caller gives the height or shape of the person."""


def size_is_unknown(found: ClipFit) -> bool:
    """Whether the person's size is undetermined: images from one place only, no known ground.

    Perspective alone would determine it only if bodies and detections were exact.
    """
    views = views_of(found.observations)
    if found.ground_known or len(views) == 0 or len(views) < len(found.observations):
        return False
    stages = [report.stage for report in found.result.reports]
    size_given = any(term.name in _SIZE_TERMS for stage in stages for term in stage.terms)
    if size_given or not any("shape" in stage.free for stage in stages):
        return False
    return not views_to_triangulate(views)


def with_unknown_size(deviations: Deviations, found: ClipFit) -> Deviations:
    """Increase standard deviations by the effect of the person's unknown size and distance.

    An unknown size scales everything about the camera's centre by one factor, whose standard
    deviation is that of people's heights relative to their mean.
    """
    estimate = found.result.estimate
    body = estimate.body.model.to(dtype=torch.float64)
    gradient = _height_gradient(body, estimate.motion.shape[0].detach().double())
    tall = float(body.height(estimate.motion.shape[0].detach().double()))
    size_std = float(gradient.norm()) / tall
    camera = views_of(found.observations)[0].camera
    eye = camera.T_world_camera[0].reshape(-1, 4, 4)[:, :3, 3].mean(0)
    joints = estimate.scene.to_recording(estimate.body.joints)[0].detach()
    distance = (joints - eye).norm(dim=-1).to(deviations.joints)
    ground = deviations.ground
    if ground is not None:
        above = float((found.T_world_recording[0].to(eye) @ torch.cat((eye, eye.new_ones(1))))[2])
        spread = (ground.height**2 + (size_std * above) ** 2) ** 0.5
        ground = replace(ground, height=spread)
    shape = (gradient / gradient.norm()).to(deviations.shape)
    return replace(
        deviations,
        # errors of distance lie along the camera's ray; the variance is divided among three axes
        joints=(deviations.joints.square() + (size_std * distance).square() / 3).sqrt(),
        shape=(deviations.shape.square() + shape.square()).sqrt(),
        ground=ground,
    )


def _height_gradient(body: BodyModel, shape: Float[Tensor, " shape"]) -> Float[Tensor, " shape"]:
    """Return the change of body height (m) per standard deviation of every shape coefficient."""
    steps = shape + _STEP * torch.eye(len(shape)).to(shape)
    return torch.stack([(body.height(one) - body.height(shape)) / _STEP for one in steps])


_CONTACT_KEYPOINTS = tuple(
    tuple(f"{side}_{name}" for name in names)
    for side in ("left", "right")
    for names in (("heel", "ankle"), ("big_toe", "small_toe"))
)
"""Keypoint names of the parts that rest on the ground: heel and toes of each foot."""
_LAG_S = 0.2
"""Time (s) between the two image positions from which a velocity is computed."""
_MIN_RESTING_SHARE = 0.3
"""Share of the frames in which some part of a foot rests if the camera is fixed."""
_MIN_SEEN_S = 0.8
"""Total time (s) for which feet must be seen."""
_MOVING_M_S = 0.035
"""Speed (m/s at the person) of the slowest part of the feet, above which the camera moves. It
reaches 0.018 in simulated films of validation people by fixed cameras, 0.025 in real ones."""
_FLYING_M_S, _FLYING_SHARE = 0.5, 0.05
"""Speed (m/s) that the slowest part of the feet exceeds in this share of the frames if the person
may run or jump. In 19 of 20 clips, training people who walk before a phone held in the hand stay
below it, and those who run before a fixed camera exceed it."""
_BRIEF_S, _BRIEF_SHARE = 0.13, 0.2
"""Time (s) for which a foot of a runner or jumper rests, and share of frames in which one does."""
_NEVER_RESTS_M_S, _NEVER_RESTS_SHARE = 0.05, 0.12
"""Speed of the slowest part of the feet over `_BRIEF_S`, in m/s and as a share of its speed in
flight, above which not even a runner's foot rests, so that the camera moves. Training people who
run before fixed cameras reach a share of 0.10."""
_RESTING_M_S = 0.01
"""Speed (m/s) below which feet rest as before a fixed camera, in 19 of 20 simulated films of
validation people."""
_CARRIED_M_S = 0.3
"""Speed (m/s) above which the camera is panned or carried along rather than shaken."""


@dataclass(frozen=True)
class SlowestFootSpeeds:
    """Speeds of whichever part of the feet moves slowest in the image, in m/s at the person."""

    speed: float
    """Speed that is undercut in `_MIN_RESTING_SHARE` of the frames, corrected for keypoint
    noise."""
    noise: float
    """Speed (m/s) that keypoint noise alone makes a resting keypoint appear to have."""
    top_speed: float
    """Speed (m/s) that is exceeded in `_FLYING_SHARE` of the frames only, as in flight."""
    brief_speed: float
    """Speed (m/s) over the time `_BRIEF_S` that is undercut in `_BRIEF_SHARE` of the frames,
    corrected for keypoint noise."""

    @property
    def camera_moves(self) -> bool:
        """Whether the camera surely moves: even resting feet move in the image."""
        never_rests = self.brief_speed > max(_NEVER_RESTS_M_S, _NEVER_RESTS_SHARE * self.top_speed)
        return self.speed > _MOVING_M_S and (self.top_speed < _FLYING_M_S or never_rests)

    @property
    def camera_may_move(self) -> bool:
        """Whether the camera may move: even the slowest feet move faster than resting feet do."""
        return self.speed > _RESTING_M_S


def slowest_foot_speeds(images: Images) -> SlowestFootSpeeds | None:
    """Measure the slowest image speeds of the feet in one view; None if feet are hardly seen."""
    usual, brief = _slowest_speeds(images, _LAG_S), _slowest_speeds(images, _BRIEF_S)
    if usual is None or brief is None:
        return None
    return SlowestFootSpeeds(
        speed=_speed_quantile(*usual, _MIN_RESTING_SHARE),
        noise=usual[1],
        top_speed=float(np.quantile(usual[0], 1 - _FLYING_SHARE)),
        brief_speed=_speed_quantile(*brief, _BRIEF_SHARE),
    )


def _speed_quantile(speeds: Float[np.ndarray, " moments"], noise: float, share: float) -> float:
    """Return a quantile of speed over time (m/s) after subtracting the variance of the noise."""
    return float(np.sqrt(max(np.quantile(speeds, share) ** 2 - noise**2, 0.0)))


def _slowest_speeds(
    images: Images, lag: float
) -> tuple[Float[np.ndarray, " moments"], float] | None:
    """Return the speed of the slowest part of the feet in every frame, and that due to noise.

    Both are in m/s at the person, computed over a time lag (s); the second is the speed that
    keypoint noise gives a resting foot. None where feet are hardly seen.
    """
    half = max(1, round(lag * images.fps / 2))
    rows = [
        [images.points.index(name) for name in names if name in images.points]
        for names in _CONTACT_KEYPOINTS
    ]
    place = np.stack(
        [images.shown[0, :, own].mean(0) for own in rows if own] or [np.zeros((0, 2))]
    )
    if place.shape[1] <= 2 * half:
        return None
    lag = 2 * half / images.fps
    moved = np.linalg.norm(place[:, 2 * half :] - place[:, : -2 * half], axis=-1)
    speeds = np.nan_to_num(moved / lag / images.scale[0, half:-half], nan=np.inf)
    slowest, which = speeds.min(0), speeds.argmin(0)
    known = np.isfinite(slowest)
    if known.sum() < _MIN_SEEN_S * images.fps:
        return None
    # second differences in time show noise: their mean absolute value over both coordinates
    jitter = np.abs(np.diff(place, 2, axis=1)).mean(-1)[:, half - 1 : place.shape[1] - half - 1]
    spread = np.nanmedian(jitter[which, np.arange(len(which))][known]) / NORMAL_MAD / np.sqrt(6)
    noise = spread * np.sqrt(2) / lag / float(np.median(images.scale[0]))
    return slowest[known], float(noise)


def moving_finding(name: str, images: Images, rest: SlowestFootSpeeds) -> Finding:
    """Return the warning that the only camera of a clip moves although it is declared fixed.

    Args:
        name: name of the camera, for the message.
        images: keypoints of the only view.
        rest: image speeds of the slowest part of its feet.
    """
    pixels = rest.speed * float(np.median(images.scale[0]))
    how = (
        "as where the camera is panned with a person or carried along, or the person is on a "
        "treadmill"
        if rest.speed > _CARRIED_M_S
        else "as where the camera is held in the hand, or slowly panned"
    )
    return Finding(
        "camera moves",
        f"{name}: no part of any foot rests in the image: what moves least moves by {pixels:.0f} "
        f"pixels per second ({100 * rest.speed:.0f} cm/s at the person), {how}. The camera was "
        "declared fixed; places, headings and contacts of the fit are not to be trusted. Film "
        "with a fixed camera, or give the camera's track (--camera-track, in Python camera_track) "
        "as a tracker wrote it. If the camera stood still, no foot bears the person, who runs, "
        "skates, swims or sits",
        value=rest.speed,
    )
