"""Checks of cameras by the fitted person: distance, focal length, scale and movement.

Whoever stands, walks or dances has some part of a foot at rest on the ground most of the time. In
the image of a fixed camera its keypoints then stay where they are. In that of a phone in the hand,
one that is panned with a walker, or one that is carried along, nothing ever stays. Who runs or
jumps has no foot at rest most of the time either, but flies then, and rests in between for a
moment.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from observations.camera_paths import can_triangulate, on_first_clock
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.core.residuals import NORMAL_MAD
from recon.diagnosis.findings import NOTHING, Finding, Findings
from recon.diagnosis.images import Images
from recon.fitting.records import ClipFit
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate
from recon.method.sensor import views_of

_NEAR, _FAR = 0.7, 40.0
"""Metres at which people are filmed."""


def distance_warnings(name: str, seen: Keypoints2D, estimate: Estimate) -> list[Finding]:
    """Warn of an implausible distance of the person, which a wrong focal length causes."""
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


_LEAST, _MOST = 0.5, 2.0
"""Factors by which a found focal length may be off the guessed one; beyond them, one is wrong."""


def lens_findings(name: str, found: ClipFit) -> Findings:
    """A finding with the fitted focal length of the uncalibrated camera; none if all are known.

    A warning where it is none of a phone's main camera.

    Args:
        name: of the camera, for the message.
        found: the fit of one clip.
    """
    lens = found.result.estimate.scene.lens
    if not found.lens_found or lens is None:
        return NOTHING
    (view,) = views_of(found.observations)
    factor = float(lens.factor[0])
    focal = float(view.camera.camera_matrix[0, ..., 0, 0].mean())
    message = (
        f"{name}: the focal length was taken as {focal / factor:.0f} pixels and found with the "
        f"motion as {focal:.0f} pixels; poses depend on it little, the distance of the camera as "
        "much as it is wrong. Give a calibration (--camera) where distances matter"
    )
    said = (Finding("focal", message, value=focal),)
    return Findings(diagnosis=said) if _LEAST < factor < _MOST else Findings(warnings=said)


_STEP = 0.01
_TELLING = frozenset({"height", "known shape"})
"""Terms by which a caller gives the size of the person."""


def size_is_unknown(found: ClipFit) -> bool:
    """Whether only images from one place, without a ground, show how large the person is.

    Perspective alone would, if bodies and detections were exact; they are not.
    """
    views = views_of(found.observations)
    if found.ground_known or len(views) == 0 or len(views) < len(found.observations):
        return False
    stages = [report.stage for report in found.result.reports]
    given = any(term.name in _TELLING for stage in stages for term in stage.terms)
    if given or not any("shape" in stage.free for stage in stages):
        return False
    alike = on_first_clock(views)
    return len(alike) == 1 or not can_triangulate(alike)


def with_unknown_size(deviations: Deviations, found: ClipFit) -> Deviations:
    """Standard deviations that include the unknown size of the person, and with it the distance.

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
        # the error is along the camera's ray: each axis gets a third of its variance
        joints=(deviations.joints.square() + (factor * distance).square() / 3).sqrt(),
        shape=(deviations.shape.square() + shape.square()).sqrt(),
        ground=ground,
    )


def _height_direction(body: BodyModel, shape: Float[Tensor, " shape"]) -> Float[Tensor, " shape"]:
    """Metres that a standard deviation of every coefficient adds to the height."""
    steps = shape + _STEP * torch.eye(len(shape)).to(shape)
    return torch.stack([(body.height(one) - body.height(shape)) / _STEP for one in steps])


_CONTACTS = tuple(
    tuple(f"{side}_{name}" for name in names)
    for side in ("left", "right")
    for names in (("heel", "ankle"), ("big_toe", "small_toe"))
)
"""Keypoints of the parts of feet that rest on the ground."""
_LAG = 0.2
"""Seconds over which velocities are taken."""
_MIN_RESTING_SHARE = 0.3
"""Share of the moments in which some part of a foot rests, of a fixed camera."""
_MIN_SEEN_S = 0.8
"""Seconds for which feet must be seen."""
_MOVES = 0.035
"""Metres per second, at the person, from which on what rests most moves in the image. In simulated
films of validation people by fixed cameras it reaches 0.018, in real ones 0.025."""
_FLIES, _SELDOM = 0.5, 0.05
"""Metres per second by which what rests most moves in so small a share of the moments, from which
on the person may run or jump. Training people who walk before a phone in the hand stay below,
those who run before a fixed camera above, in 19 clips of 20."""
_BRIEF, _SOMETIMES = 0.13, 0.2
"""Seconds for which a foot of somebody who runs or jumps rests, and the share of the moments."""
_NEVER_RESTS, _EVEN = 0.05, 0.12
"""Speed, metres per second and as a share of that of the flights, from which on not even then
does a foot rest. Training people who run before fixed cameras reach a share of 0.10."""
_HINT = 0.01
"""Metres per second below which feet rest as before a fixed camera, in 19 of 20 simulated films of
validation people."""
_FAST = 0.3
"""Metres per second from which on the camera is panned or carried along rather than shaken."""


@dataclass(frozen=True)
class SlowestFootSpeeds:
    """How fast the slowest part of the feet moves in the image."""

    speed: float
    """Metres per second at the person, without what the noise of the keypoints makes of it."""
    noise: float
    """Speed that the noise makes of a keypoint at rest, metres per second."""
    flying: float
    """Speed of what rests most in the few moments in which it is fastest, metres per second."""
    brief: float
    """Speed over a short time, of the fifth of the moments in which it is slowest, without what
    the noise makes of it; metres per second."""

    @property
    def moves(self) -> bool:
        """Whether even resting feet move in the image, so that the camera surely moves."""
        never = self.brief > max(_NEVER_RESTS, _EVEN * self.flying)
        return self.speed > _MOVES and (self.flying < _FLIES or never)

    @property
    def may_move(self) -> bool:
        """Whether the camera may move: the slowest feet move faster than resting ones."""
        return self.speed > _HINT


def slowest_foot_speeds(images: Images) -> SlowestFootSpeeds | None:
    """The slowest speeds of the feet in a single view; None where feet are hardly seen."""
    usual, brief = _speed_of_resting_foot(images, _LAG), _speed_of_resting_foot(images, _BRIEF)
    if usual is None or brief is None:
        return None
    return SlowestFootSpeeds(
        speed=_speed_quantile(*usual, _MIN_RESTING_SHARE),
        noise=usual[1],
        flying=float(np.quantile(usual[0], 1 - _SELDOM)),
        brief=_speed_quantile(*brief, _SOMETIMES),
    )


def _speed_quantile(speeds: Float[np.ndarray, " moments"], noise: float, share: float) -> float:
    """A quantile of speed over time, corrected for the noise."""
    return float(np.sqrt(max(np.quantile(speeds, share) ** 2 - noise**2, 0.0)))


def _speed_of_resting_foot(
    images: Images, lag: float
) -> tuple[Float[np.ndarray, " moments"], float] | None:
    """Speed of the slowest part of the feet, at every moment where one was seen.

    Metres per second at the person over a time lag, seconds, and the speed that the noise makes;
    None where feet are hardly seen.
    """
    half = max(1, round(lag * images.fps / 2))
    rows = [
        [images.points.index(name) for name in names if name in images.points]
        for names in _CONTACTS
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
    # mean size of the second difference in time of both image coordinates
    jitter = np.abs(np.diff(place, 2, axis=1)).mean(-1)[:, half - 1 : place.shape[1] - half - 1]
    spread = np.nanmedian(jitter[which, np.arange(len(which))][known]) / NORMAL_MAD / np.sqrt(6)
    noise = spread * np.sqrt(2) / lag / float(np.median(images.scale[0]))
    return slowest[known], float(noise)


def moving_finding(name: str, images: Images, rest: SlowestFootSpeeds) -> Finding:
    """A finding if the only camera of a clip moves although it is declared fixed.

    Args:
        name: of the camera, for the message.
        images: of the one view.
        rest: how fast its feet move.
    """
    pixels = rest.speed * float(np.median(images.scale[0]))
    how = (
        "as where the camera is panned with a person or carried along, or the person is on a "
        "treadmill"
        if rest.speed > _FAST
        else "as where the camera is held in the hand, or slowly panned"
    )
    return Finding(
        "camera moves",
        f"{name}: no part of any foot rests in the image: what moves least moves by "
        f"{pixels:.0f} pixels per second ({100 * rest.speed:.0f} cm/s at the person), {how}. The "
        "camera was declared fixed; places, headings and contacts of the fit are not to be "
        "trusted. Film with a fixed camera, or give the camera's track (--camera-track, in Python "
        "camera_track) as a tracker wrote it. Otherwise the feet bear nobody: the person runs, "
        "skates, swims or sits",
        value=rest.speed,
    )
