"""What is checked of one clip: its data before a fit, and the result after it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from observations import kinds
from observations.first_guess import labelled
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.diagnosis.agreement import ResidualSummary, agreement_warnings, summarise
from recon.diagnosis.certainty import MOST, certainty, fitted_contacts
from recon.diagnosis.doubts import (
    Alternative,
    alternatives,
    guessed_findings,
    observed_joints,
    undecided_findings,
    unseen_findings,
)
from recon.diagnosis.findings import Finding
from recon.diagnosis.motions.belt import treadmill_finding, with_belt
from recon.diagnosis.motions.gravity import rate_finding
from recon.diagnosis.motions.support import support_findings
from recon.diagnosis.plausibility import (
    body_warnings,
    child_findings,
)
from recon.diagnosis.points.screening import screen_points
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor

_NO_SPEED = frozenset({"identity change", "frame order"})
"""Findings after which the speed of the motion says nothing about its rate."""


@dataclass(frozen=True)
class Examined:
    """A fit, and what is known about the data and the result."""

    fit: ClipFit
    residuals: tuple[ResidualSummary, ...]
    """Residuals of every sensor, in the order of the observations."""
    diagnosis: tuple[Finding, ...]
    """What is worth knowing but is no fault: limbs and frames that were inferred, feet at several
    heights, rests on something else than feet."""
    repairs: tuple[Finding, ...]
    """What was wrong with the data and was put right before the fit."""
    warnings: tuple[Finding, ...]
    """What should be read before the result is used."""
    observed: Bool[np.ndarray, "time 22"]
    """False where a joint of the fitted motion was inferred rather than seen."""
    deviations: Deviations | None = None
    """Standard deviations of joints, root and shape; None where the prior has no density."""
    alternatives: tuple[Alternative, ...] = ()
    """Other motions that the fit compared with the one it gives, the likeliest first."""
    belt: Float[Tensor, " 2"] | None = None
    """Velocity of the treadmill in the recording, m/s; the fit is in the frame that moves with
    it. None where feet stand in the room."""

    def observed_at(self, motion: Motion) -> Bool[np.ndarray, "time 22"]:
        """`observed` at the frames of the fitted motion resampled to another rate."""
        return self.observed[self._frames(motion, len(self.observed))]

    def joint_std_at(self, motion: Motion) -> Float[Tensor, "time 22"] | None:
        """Standard deviations of a joint's coordinates at the frames of that motion, metres."""
        if self.deviations is None:
            return None
        joints = self.deviations.joints
        return joints[torch.from_numpy(self._frames(motion, len(joints)))].float().cpu()

    def angle_std_at(self, motion: Motion) -> Float[Tensor, "time angles"] | None:
        """Standard deviations of ISB angles at the frames of that motion, degrees."""
        if self.deviations is None or self.deviations.measures is None:
            return None
        angles = self.deviations.measures.clamp(max=MOST)
        return angles[torch.from_numpy(self._frames(motion, len(angles)))].float().cpu()

    def contact_probability_at(self, motion: Motion) -> Float[Tensor, "time 22"] | None:
        """How likely joints touch the ground in frames of that motion; None without a ground."""
        if not self.fit.grounded:
            return None
        contacts = fitted_contacts(self.fit, self.deviations)
        return contacts[torch.from_numpy(self._frames(motion, len(contacts)))].float()

    @property
    def ground_std(self) -> Float[Tensor, "2"] | None:
        """Standard deviations of a ground that was found: normal, radians, and height, metres."""
        ground = None if self.deviations is None else self.deviations.ground
        return None if ground is None else torch.tensor([ground.normal, ground.height])

    def _frames(self, motion: Motion, count: int) -> Int[np.ndarray, " time"]:
        """The fitted frame that is nearest to each of a motion's."""
        fitted = self.fit.result.motion
        times = motion.start_time + np.arange(motion.frames) / motion.fps
        frames = np.rint((times - fitted.start_time) * fitted.fps).astype(int)
        return np.clip(frames, 0, count - 1)


@dataclass(frozen=True)
class ScreenedClip:
    """A clip's observations as they should be fitted, and what was found."""

    observations: tuple[Sensor, ...]
    repairs: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    belt: Float[Tensor, " 2"] | None = None
    """Velocity of the treadmill that the observations were freed from, m/s."""


def screen(
    observations: Sequence[Sensor], names: Sequence[str], options: FitOptions, body: BodyModel
) -> ScreenedClip:
    """Check all sensors of a clip before the fit; without `options.repair` nothing is done."""
    if not options.repair:
        return ScreenedClip(tuple(observations))
    kept = list(observations)
    repairs: list[Finding] = []
    warnings: list[Finding] = []
    if views := kinds.views(observations):
        # images load their own checks
        from recon.diagnosis.views.screening import screen_views

        rows = [k for k, one in enumerate(observations) if kinds.views([one])]
        checked, repairs, warnings = screen_views(views, [names[k] for k in rows], body)
        for row, view in zip(rows, checked, strict=True):
            kept[row] = view
    belts: list[Float[Tensor, " 2"]] = []
    for row, one in enumerate(observations):
        for points in kinds.tracked([one]):
            found = screen_points(points, body, grounded=options.grounded)
            kept[row] = found.points
            repairs += [_of(names[row], finding) for finding in found.repairs]
            warnings += [_of(names[row], finding) for finding in found.warnings]
            belts += [] if found.belt is None else [found.belt]
    clip = ScreenedClip(tuple(kept), tuple(repairs), tuple(warnings))
    tracked = kinds.tracked(kept)
    if not belts:
        return clip
    if len(tracked) < len(kept) or options.completes:  # these stay in the room
        return replace(
            clip,
            repairs=tuple(one for one in clip.repairs if one.code != "treadmill"),
            warnings=(*clip.warnings, treadmill_finding(belts[0])),
        )
    carried = tuple(with_belt(one, belts[0]) for one in tracked)
    return replace(clip, observations=carried, belt=belts[0])


def examine(found: ClipFit, names: Sequence[str], screened: ScreenedClip) -> Examined:
    """What residuals and the fitted body say about a fit that is done."""
    estimate = found.result.estimate
    body = estimate.body.model.to(device="cpu")
    here = Estimate(estimate.decoded, estimate.body, estimate.scene.detach())
    sensors = list(zip(names, found.observations, found.noises, strict=True))
    summaries = tuple(summarise(name, seen, noise, here) for name, seen, noise in sensors)
    views = kinds.views(found.observations)
    observed = observed_joints(found.observations, here)
    motion = found.result.clip(0).detach().to(device="cpu")
    seen = torch.from_numpy(observed[: motion.frames])
    broken = any(finding.code in _NO_SPEED for finding in screened.warnings)
    sizes = body_warnings(found)
    # cameras whose ground and person do not fit together measure in no metres
    unmeasured = len(views) > 0 and any(finding.code == "floor" for finding in sizes)
    # without a ground, neither gait nor falls nor standing feet tell anything
    free = broken or not found.grounded
    rate = None if free or unmeasured else rate_finding(motion, body, seen)
    carried = None
    if found.grounded:
        carried = _carried(names, found.observations, motion, body, None if broken else seen)
    support = support_findings(motion, body, seen) if found.grounded else []
    others, sure = alternatives(found), certainty(found)
    lens, doubtful, mirrored = _of_images(names[0], found)
    after = [
        *(lens if doubtful else []),
        *([] if carried is None else [carried]),
        # a fit from the caller's own start was not told what the points show
        *agreement_warnings(summaries, labelled(found.observations), here),
        *sizes,
        *mirrored,
        *([] if rate is None else [rate]),
        *undecided_findings(others),
    ]
    guessed: list[Finding] = []
    if sure is not None:
        guessed = guessed_findings(sure.joints.numpy(), observed, motion.fps)
    return Examined(
        fit=found,
        residuals=summaries,
        diagnosis=(
            *([] if doubtful else lens),
            *unseen_findings(observed),
            *guessed,
            *support,
            *child_findings(found),
        ),
        repairs=screened.repairs,
        warnings=(*screened.warnings, *after),
        observed=observed,
        deviations=sure,
        alternatives=others,
        belt=screened.belt,
    )


def _of_images(name: str, found: ClipFit) -> tuple[list[Finding], bool, list[Finding]]:
    """The focal length that was found, whether it is doubtful, and images that are mirrored."""
    if not (views := kinds.views(found.observations)):
        return [], False, []
    from recon.diagnosis.views.fitted import lens_doubtful, lens_finding, mirror_warnings

    lens = lens_finding(name, found)
    return [] if lens is None else [lens], lens_doubtful(found), mirror_warnings(views)


def _carried(
    names: Sequence[str],
    observations: Sequence[Sensor],
    motion: Motion,
    body: BodyModel,
    observed: Bool[Tensor, "time 22"] | None,
) -> Finding | None:
    """Whether a camera moved that alone has seen the clip, and that is declared fixed.

    Joints that were `observed` are None where speeds of the motion mean nothing.
    """
    views = kinds.views(observations)
    if len(observations) > 1 or not views or views[0].camera.T_camera_world.shape[-3] > 1:
        return None
    from recon.diagnosis.motions.carried import carried_finding
    from recon.diagnosis.views.images import Images
    from recon.diagnosis.views.rest import moving_finding, rest_of

    images = Images.of(views, names, body)
    rest = rest_of(images)
    if rest is not None and rest.moves:
        return moving_finding(names[0], images, rest)
    if observed is None:
        return None
    rests = rest is not None and not rest.may_move
    return carried_finding(names[0], motion, body, observed, rests=rests)


def _of(name: str, finding: Finding) -> Finding:
    return replace(finding, message=f"{name}: {finding.message}")
