"""Uncertainty of a fit: standard deviations, other hypotheses, and joints that were not seen.

The standard deviations of every joint come from the curvature of the fit's objective.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.angles import isb_slopes
from recon.body.contacts import contact_probabilities, rest_heights
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.residuals import Unit
from recon.core.skeleton import JOINTS, LEGS, MIRROR
from recon.fitting.clip import GROUND_DEVIATION
from recon.fitting.records import ClipFit
from recon.method.derivatives import GroundBelief
from recon.method.laplace import Deviations, Measure, deviations
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor, frame_is_level, views_of
from recon.method.stages import ComparedHypotheses

if TYPE_CHECKING:
    from recon.formats.joint_table import JointCertainty
else:  # imported for type checkers only
    from typing import Any as JointCertainty

MOST = 360 / 12**0.5
"""Degrees: the standard deviation of an angle of which nothing is known."""


def angle_slopes(body: BodyModel) -> Measure | None:
    """Derivatives of ISB angles by rotation steps, degrees per radian; None for another body."""

    def slopes(motion: Motion) -> Float[Tensor, "time angles 66"]:
        return torch.from_numpy(isb_slopes(motion, body)).to(motion.translation)

    # landmarks are only defined on the bundled body
    return slopes if body.checksum == BodyModel.load().checksum else None


_WORTH: dict[Unit, float] = {"metres": 4.0, "pixels": 1.0}
"""Independent observations that one in this unit is worth. Priors smooth more than the density
that stands for them says, so errors are smaller than its curvature promises; chosen on validation
people so that 90 % of the errors of seen joints lie within 1.645 standard deviations."""
_CLOUD_WORTH = 0.05
"""What a patch of a cloud's surface in one frame is worth, chosen likewise: what a body of other
flesh and clothes misses stays the same over many frames."""
_STANCE = 0.03
"""Metres by which standing feet miss the ground, clip by clip."""
_LEAN_STD_RAD = 0.04
"""Radians by which people lean on average over a clip, without what a prior knows of gravity."""
_UPRIGHT_ALONE = 0.09
"""Radians likewise where the ground is only put below people, by priors that know no gravity."""


def certainty(found: ClipFit) -> Deviations | None:
    """Standard deviations of a fit's joints; None where its prior gives no density.

    Clouds are thinned first: neighbouring points err alike.
    """
    estimate = found.result.estimate
    least = min(noise.metres for noise in found.noises)
    density = reports[-1].stage.prior.belief(least) if (reports := found.result.reports) else None
    if density is None or found.result.failed[0]:
        return None
    seen, noises = [], []
    for one, noise in zip(found.observations, found.noises, strict=True):
        thin, worth, model = one, _WORTH.get(one.unit, 1.0), estimate.body.model
        if not one.point_names(model):
            thin, worth = one.coarse(model), _CLOUD_WORTH
            noise = thin.noise(estimate.motion, model, noise.metres)
        seen.append(thin)
        noises.append(replace(noise, own=noise.own / worth**0.5))
    with torch.no_grad():
        try:
            body = estimate.body.model.to(dtype=torch.float64)
            known = deviations(
                estimate, seen, noises, density, _ground_uncertainty(found), angle_slopes(body)
            )
        except (ArithmeticError, RuntimeError):  # the Hessian is singular
            return None
    if not views_of(found.observations):
        return known
    # images alone do not show how large a person is
    from recon.diagnosis.cameras import size_is_unknown, with_unknown_size

    with torch.no_grad():
        return with_unknown_size(known, found) if size_is_unknown(found) else known


def _ground_uncertainty(found: ClipFit) -> GroundBelief | None:
    """The assumed uncertainty of the ground; None where there is no ground."""
    if not found.grounded:
        return None
    if found.ground_known:
        return GroundBelief(_STANCE, _LEAN_STD_RAD, 0)
    level = frame_is_level(found.observations)
    shown = GROUND_DEVIATION**-2 if found.ground_seen else 0.0
    knows = found.result.reports[-1].stage.prior.knows_gravity
    upright = _LEAN_STD_RAD if knows else _UPRIGHT_ALONE
    return GroundBelief(_STANCE, upright, 1 if level else 3, shown)


def certainty_report(deviations: Deviations, joints: JointCertainty | None) -> dict[str, Any]:
    """Standard deviations as a report has them: medians of joints and root, shape, ground."""
    every = deviations.joints.median(0).values.tolist()
    ground = deviations.ground
    found = ground and {"normal_degrees": ground.normal_degrees, "height": ground.height}
    return {
        **({} if joints is None else asdict(joints)),
        **({} if ground is None else {"ground": found}),
        "joints": dict(zip(JOINTS, every, strict=True)),
        "root": float(deviations.root.median()),
        "shape": deviations.shape.tolist(),
    }


_HEIGHT_STD_RATIO = 0.3
"""Ratio of the standard deviation of a joint's height to that of its coordinates under a prior
that knows gravity, which holds standing feet to the ground. Both ratios were chosen by likelihood
on validation people, over all sensors of `benchmarks.uncertainty`."""
_FREE = 1.4
"""The ratio under the other priors, whose hidden feet may end anywhere."""


def fitted_contacts(fit: ClipFit, deviations: Deviations | None) -> Float[Tensor, "time 22"]:
    """Probability that each joint of the fit's only clip touches the ground z = 0.

    Args:
        fit: of one clip.
        deviations: how sure its joints are; None takes all as seen.
    """
    motion, posed = fit.result.clip(0).detach(), fit.result.body
    joints = posed.joints[0, : motion.frames].detach()
    heights = rest_heights(posed.model, motion.shape)
    if deviations is None:
        return contact_probabilities(joints, heights, motion.fps)
    held = not fit.result.reports or fit.result.reports[-1].stage.prior.knows_gravity
    std = (_HEIGHT_STD_RATIO if held else _FREE) * deviations.joints[: motion.frames]
    return contact_probabilities(joints, heights, motion.fps, std.to(joints))


_SAME_MOTION_M = 0.05
"""Mean distance of joints, metres, below which two hypotheses have come to the same motion."""
_TURNED = math.radians(45)
"""Turn about the vertical from which on a hypothesis is one of another heading."""
_LEGS, _EXCHANGED = list(LEGS), [MIRROR[k] for k in LEGS]


@dataclass(frozen=True)
class AlternativeMotion:
    """Another motion that explains the data, and by how much its energy is higher."""

    kind: str
    """What distinguishes it: "heading", "leg order" or "posture"."""
    turn: float
    """Degrees about the vertical, from 0 to 180, by which it faces elsewhere, on average."""
    distance: float
    """Mean distance of its joints from those of the motion that was chosen, metres."""
    energy: float
    """Its objective, at the end of the stage that compared it."""
    chosen_energy: float
    """The objective of the motion that was chosen, at the end of the same stage."""

    @property
    def excess(self) -> float:
        """By how much this motion's energy is larger, as a share of the chosen motion's."""
        if self.chosen_energy <= 0:  # as happens with data without noise
            return math.inf
        return self.energy / self.chosen_energy - 1

    def report(self) -> dict[str, Any]:
        """The record as it stands in a report's list `alternatives`."""
        excess = self.excess if math.isfinite(self.excess) else None
        return {**asdict(self), "excess": excess, "message": str(self)}

    def __str__(self) -> str:
        """The alternative in words."""
        what = {
            "heading": f"facing {self.turn:.0f} degrees elsewhere",
            "leg order": "with left and right leg exchanged",
            "posture": "in another posture",
        }[self.kind]
        return (
            f"{what}, {100 * self.distance:.0f} cm away: energy {100 * self.excess:+.1f} % of "
            "that of the result"
        )


def alternatives(fit: ClipFit) -> tuple[AlternativeMotion, ...]:
    """Rejected hypotheses of the first clip, the likeliest first.

    They are other first guesses (headings, postures) and other beginnings of a gait cycle, each as
    the quick fit that compared them had left it. Hypotheses that came to the motion that was
    chosen, or to that of a likelier one, are left out.
    """
    body = fit.result.body.model
    found = [one for compared in fit.compared for one in _runners_up(compared, body)]
    return tuple(sorted(found, key=lambda one: one.excess))


def _runners_up(compared: ComparedHypotheses, body: BodyModel) -> list[AlternativeMotion]:
    """The hypotheses that one comparison rejected."""
    own = (compared.clip == 0).nonzero()[:, 0]
    finite = own[compared.value[own].isfinite()]
    kept = finite[compared.kept[finite]]
    if len(kept) == 0:
        return []
    best = int(kept[compared.value[kept].argmin()])
    given_up = finite[~compared.kept[finite]]
    ordered = given_up[compared.value[given_up].argsort()].tolist()
    with torch.no_grad():
        clips = [compared.motion[k] for k in (best, *ordered)]
        posed = [body.pose(one.window(0, int(one.valid.sum()))).joints for one in clips]
    (kept_joints, *others), found = posed, list[AlternativeMotion]()
    distinct = [kept_joints]
    for row, joints in zip(ordered, others, strict=True):
        if all(_mean_joint_distance(joints, other) > _SAME_MOTION_M for other in distinct):
            distinct.append(joints)
            turn = _heading_difference(compared.motion[best], compared.motion[row])
            sides = [
                _mean_joint_distance(joints[:, legs], kept_joints[:, _LEGS])
                for legs in (_EXCHANGED, _LEGS)
            ]
            kind = "leg order" if sides[0] < 0.5 * sides[1] else "posture"
            kind = "heading" if turn > _TURNED else kind
            energies = (float(compared.value[k]) for k in (row, best))
            found.append(
                AlternativeMotion(
                    kind, math.degrees(turn), _mean_joint_distance(kept_joints, joints), *energies
                )
            )
    return found


def _mean_joint_distance(
    one: Float[Tensor, "time some 3"], other: Float[Tensor, "time some 3"]
) -> float:
    """Mean distance of joints, metres."""
    return float((one - other).norm(dim=-1).mean())


def _heading_difference(one: Motion, other: Motion) -> float:
    """Angle about the vertical between the headings of two motions, averaged; 0 to pi."""
    between = so3.heading(one.rotations[:, 0]).mT @ so3.heading(other.rotations[:, 0])
    mean = between[one.valid].mean(0)
    return abs(math.atan2(float(mean[1, 0] - mean[0, 1]), float(mean[0, 0] + mean[1, 1])))


def observed_joints(
    observations: Sequence[Sensor], estimate: Estimate
) -> Bool[np.ndarray, "time 22"]:
    """The joints that some sensor saw, for every frame of the first clip's motion.

    A joint is seen where a visible point lies within 20 cm of it at rest and on a bone that ends
    or begins there; or where points of a cloud lie within 15 cm of it.
    """
    motion = estimate.motion
    times = motion.start_time + np.arange(motion.frames) / motion.fps
    seen = np.zeros((motion.frames, len(JOINTS)), dtype=bool)
    for observation in observations:
        moments = observation.shown_joints(estimate)
        # the observation's nearest frame in time, for every frame of the motion
        number = np.rint((times - observation.start_time) * observation.fps).astype(int)
        within = (number >= 0) & (number < len(moments))
        seen[within] |= moments[number[within]]
    return seen
