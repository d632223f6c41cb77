"""What a fitted person says about cameras: distance, focal length, size, and whether they move.

Whoever stands, walks or dances has some part of a foot at rest on the ground most of the time. In
the image of a fixed camera its keypoints then stay where they are. In that of a phone in the hand,
one that is panned with a walker, or one that is carried along, nothing ever stays. Who runs or
jumps has no foot at rest most of the time either, but flies then, and rests in between for a
moment.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.camera_paths import tell_distance, triangulate
from observations.first_guess import one_clock
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.core.robust import NORMAL_MAD
from recon.diagnosis.findings import Finding
from recon.diagnosis.images import Images
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
"""Time in which feet must be seen to tell anything."""
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
class Rest:
    """How fast the part of the feet that rests most moves in the image."""

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
        """Whether the camera surely moves."""
        never = self.brief > max(_NEVER_RESTS, _EVEN * self.flying)
        return self.speed > _MOVES and (self.flying < _FLIES or never)

    @property
    def may_move(self) -> bool:
        """Whether the camera may be carried smoothly around a person whose feet nearly rest."""
        return self.speed > _HINT


def rest_of(images: Images) -> Rest | None:
    """What the feet tell about the one view of some images; None where they are hardly seen."""
    usual, brief = _Slowest.of(images, _LAG), _Slowest.of(images, _BRIEF)
    if usual is None or brief is None:
        return None
    return Rest(
        speed=usual.quantile(_MIN_RESTING_SHARE),
        noise=usual.noise,
        flying=float(np.quantile(usual.speeds, 1 - _SELDOM)),
        brief=brief.quantile(_SOMETIMES),
    )


@dataclass(frozen=True)
class _Slowest:
    """Speed of the part of the feet that rests most, at every moment where one was seen."""

    speeds: Float[np.ndarray, " moments"]
    """Metres per second at the person."""
    noise: float

    @classmethod
    def of(cls, images: Images, lag: float) -> "_Slowest | None":
        """Speeds over a time lag, seconds; None where feet are hardly seen."""
        half = max(1, round(lag * images.fps / 2))
        pixels, seen = images.pixels[0], images.seen[0]
        if len(pixels) <= 2 * half:
            return None
        lag = 2 * half / images.fps
        speeds, jitters = [], []
        for names in _CONTACTS:
            columns = [images.points.index(name) for name in names if name in images.points]
            if not columns:
                continue
            place, there = pixels[:, columns].mean(1), seen[:, columns].all(1)
            moved = np.linalg.norm(place[2 * half :] - place[: -2 * half], axis=-1)
            both = there[2 * half :] & there[: -2 * half]
            speeds.append(np.where(both, moved / lag / images.scale[0, half:-half], np.inf))
            jitters.append(_jitter(place, there)[half - 1 : len(place) - half - 1])
        if not speeds:
            return None
        every = np.stack(speeds)
        slowest, which = every.min(0), every.argmin(0)
        told = np.isfinite(slowest)
        if told.sum() < _MIN_SEEN_S * images.fps:
            return None
        jitter = np.stack(jitters)[which, np.arange(len(which))][told]
        spread = float(np.nanmedian(jitter)) / NORMAL_MAD / np.sqrt(6)
        noise = spread * np.sqrt(2) / lag / float(np.median(images.scale[0]))
        return cls(slowest[told], float(noise))

    def quantile(self, share: float) -> float:
        """Speed below which a share of the moments lie, without what the noise makes of it."""
        speed = float(np.quantile(self.speeds, share))
        return float(np.sqrt(max(speed**2 - self.noise**2, 0.0)))


def moving_finding(name: str, images: Images, rest: Rest) -> Finding:
    """What is said of the one camera of a clip that moves, though it is declared fixed.

    Args:
        name: of the camera, for the message.
        images: of the one view.
        rest: what its feet tell.
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


def _jitter(
    place: Float[np.ndarray, "time 2"], there: Bool[np.ndarray, " time"]
) -> Float[np.ndarray, " inner"]:
    """Mean size of the second difference of both coordinates; NaN where it is not known."""
    size = np.abs(place[2:] - 2 * place[1:-1] + place[:-2]).mean(-1)
    return np.where(there[2:] & there[1:-1] & there[:-2], size, np.nan)
