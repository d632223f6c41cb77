"""Estimates the uncertainty of a fit: standard deviations, other hypotheses, unseen joints.

Standard deviations of joints come from the Hessian of the objective at the fitted motion.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.angles import isb_angle_derivatives
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
else:  # at run time Any replaces JointCertainty, whose module need not be imported
    from typing import Any as JointCertainty

MOST = 360 / 12**0.5
"""Standard deviation (degrees) of an angle that may have any value: uniform over the circle."""


def isb_derivatives(body: BodyModel) -> Measure | None:
    """Return a function for derivatives of ISB angles by rotations; None without landmarks."""

    def derivatives(motion: Motion) -> Float[Tensor, "time angles 66"]:
        return torch.from_numpy(isb_angle_derivatives(motion, body)).to(motion.translation)

    # ISB joint angles need landmarks, which are only defined on the bundled body
    return derivatives if body.checksum == BodyModel.load().checksum else None


_WEIGHT_OF_UNIT: dict[Unit, float] = {"metres": 4.0, "pixels": 1.0}
"""Number of independent observations that one in this unit counts as. Priors smooth more than the
density that approximates them here, so errors are smaller than the Hessian predicts; chosen so
that 90 % of the errors of seen validation joints lie within 1.645 standard deviations."""
_PATCH_WEIGHT = 0.05
"""Number of independent observations that a patch of a cloud in one frame counts as, chosen
likewise: errors by another body shape and clothes stay the same over many frames."""
_STANCE_STD_M = 0.03
"""Standard deviation (m) of the mean height of standing feet above the ground, per clip."""
_LEAN_STD_RAD = 0.04
"""Standard deviation (rad) of the mean lean of a clip's body from the vertical."""
_LEAN_STD_NO_GRAVITY_RAD = 0.09
"""Standard deviation (rad) of the mean lean, if the prior does not know the direction of
gravity."""


def certainty(found: ClipFit) -> Deviations | None:
    """Return standard deviations of a fit's joints; None where its prior has no density.

    Clouds are thinned first, as neighbouring points have similar errors.
    """
    estimate = found.result.estimate
    least = min(noise.metres for noise in found.noises)
    density = reports[-1].stage.prior.belief(least) if (reports := found.result.reports) else None
    if density is None or found.result.failed[0]:
        return None
    seen, noises = [], []
    for one, noise in zip(found.observations, found.noises, strict=True):
        thin, worth, model = one, _WEIGHT_OF_UNIT.get(one.unit, 1.0), estimate.body.model
        if not one.point_names(model):
            thin, worth = one.coarse(model), _PATCH_WEIGHT
            noise = thin.noise(estimate.motion, model, noise.metres)
        seen.append(thin)
        noises.append(replace(noise, own=noise.own / worth**0.5))
    with torch.no_grad():
        try:
            body = estimate.body.model.to(dtype=torch.float64)
            known = deviations(
                estimate, seen, noises, density, _ground_uncertainty(found), isb_derivatives(body)
            )
        except (ArithmeticError, RuntimeError):  # the Hessian is singular
            return None
    if not views_of(found.observations):
        return known
    # images alone do not show a person's size, and then joints are less certain
    from recon.diagnosis.cameras import size_is_unknown, with_unknown_size

    with torch.no_grad():
        return with_unknown_size(known, found) if size_is_unknown(found) else known


def _ground_uncertainty(found: ClipFit) -> GroundBelief | None:
    """Return the assumed uncertainty of the ground; None where the fit has no ground."""
    if not found.grounded:
        return None
    if found.ground_known:
        return GroundBelief(_STANCE_STD_M, _LEAN_STD_RAD, 0)
    level = frame_is_level(found.observations)
    precision = GROUND_DEVIATION**-2 if found.ground_seen else 0.0
    knows = found.result.reports[-1].stage.prior.knows_gravity
    upright = _LEAN_STD_RAD if knows else _LEAN_STD_NO_GRAVITY_RAD
    return GroundBelief(_STANCE_STD_M, upright, 1 if level else 3, precision)


def certainty_report(deviations: Deviations, joints: JointCertainty | None) -> dict[str, Any]:
    """Return standard deviations for the report: medians of joints and root, shape, ground."""
    of_joints = deviations.joints.median(0).values.tolist()
    ground = deviations.ground
    found = ground and {"normal_degrees": ground.normal_degrees, "height": ground.height}
    return {
        **({} if joints is None else asdict(joints)),
        **({} if ground is None else {"ground": found}),
        "joints": dict(zip(JOINTS, of_joints, strict=True)),
        "root": float(deviations.root.median()),
        "shape": deviations.shape.tolist(),
    }


_HEIGHT_STD_RATIO = 0.3
"""Standard deviation of a joint's height, relative to that of a coordinate on average, under a
prior that knows gravity, which holds standing feet to the ground. This ratio and the next were
chosen by likelihood on validation people, over all sensors of `benchmarks.uncertainty`."""
_FREE_STD_RATIO = 1.4
"""Ratio as `_HEIGHT_STD_RATIO`, for priors that leave hidden feet free in height."""


def fitted_contacts(fit: ClipFit, deviations: Deviations | None) -> Float[Tensor, "time 22"]:
    """Return the probability that each joint of the fit's only clip touches the ground z = 0.

    Args:
        fit: fit of one clip.
        deviations: standard deviations of its joints; None takes all joints as certain.
    """
    motion, posed = fit.result.clip(0).detach(), fit.result.body
    joints = posed.joints[0, : motion.frames].detach()
    heights = rest_heights(posed.model, motion.shape)
    if deviations is None:
        return contact_probabilities(joints, heights, motion.fps)
    gravity = not fit.result.reports or fit.result.reports[-1].stage.prior.knows_gravity
    std = (_HEIGHT_STD_RATIO if gravity else _FREE_STD_RATIO) * deviations.joints[: motion.frames]
    return contact_probabilities(joints, heights, motion.fps, std.to(joints))


_SAME_MOTION_M = 0.05
"""Mean distance of joints (m) below which two hypotheses have converged to the same motion."""
_OTHER_HEADING_RAD = math.radians(45)
"""Difference of headings (rad) from which on a hypothesis is of the kind "heading"."""
_LEGS, _EXCHANGED = list(LEGS), [MIRROR[k] for k in LEGS]


@dataclass(frozen=True)
class AlternativeMotion:
    """Another motion that explains the data, compared with the chosen one by objective value."""

    kind: str
    """Kind of its difference from the chosen motion: "heading", "leg order" or "posture"."""
    turn: float
    """Mean difference of its heading from that of the chosen motion, 0 to 180 degrees."""
    distance: float
    """Mean distance (m) of its joints from those of the chosen motion."""
    energy: float
    """Value of its objective at the end of the stage that compared the motions."""
    chosen_energy: float
    """Value of the chosen motion's objective at the end of the same stage."""

    @property
    def excess(self) -> float:
        """Excess of this motion's energy over the chosen motion's, as a share of the latter."""
        if self.chosen_energy <= 0:  # data without noise may be fitted exactly
            return math.inf
        return self.energy / self.chosen_energy - 1

    def report(self) -> dict[str, Any]:
        """Return the record as it stands in a report's list `alternatives`."""
        excess = self.excess if math.isfinite(self.excess) else None
        return {**asdict(self), "excess": excess, "message": str(self)}

    def __str__(self) -> str:
        """Describe the alternative in words, with its distance and energy."""
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
    """Return the rejected hypotheses of the first clip, the likeliest first.

    They are other first guesses (headings, postures) and other beginnings of a gait cycle, each as
    fitted at the stage that compared it. Hypotheses that converged to the chosen motion, or to
    that of a likelier one, are left out.
    """
    body = fit.result.body.model
    found = [one for compared in fit.comparisons for one in _rejected_hypotheses(compared, body)]
    return tuple(sorted(found, key=lambda one: one.excess))


def _rejected_hypotheses(compared: ComparedHypotheses, body: BodyModel) -> list[AlternativeMotion]:
    """Return the distinct motions that one comparison of hypotheses rejected."""
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
            kind = "heading" if turn > _OTHER_HEADING_RAD else kind
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
    """Return the mean distance (m) between the joints of two motions."""
    return float((one - other).norm(dim=-1).mean())


def _heading_difference(one: Motion, other: Motion) -> float:
    """Return the mean angle (0 to pi) about the vertical between the headings of two motions."""
    between = so3.undo_heading(one.rotations[:, 0]).mT @ so3.undo_heading(other.rotations[:, 0])
    mean = between[one.valid].mean(0)
    return abs(math.atan2(float(mean[1, 0] - mean[0, 1]), float(mean[0, 0] + mean[1, 1])))


def observed_joints(
    observations: Sequence[Sensor], estimate: Estimate
) -> Bool[np.ndarray, "time 22"]:
    """Return a mask of the joints that some sensor saw in each frame of the first clip.

    A joint is seen where a visible point lies within 20 cm of it at rest and on a bone that ends
    or begins there; or where points of a cloud lie within 15 cm of it.
    """
    motion = estimate.motion
    times = motion.start_time + np.arange(motion.frames) / motion.fps
    seen = np.zeros((motion.frames, len(JOINTS)), dtype=bool)
    for observation in observations:
        moments = observation.shown_joints(estimate)
        # the observation's nearest frame in time, for every frame of the motion, which at the
        # 30 Hz of HuMoR's networks may outlast the data by up to one frame
        number = np.rint((times - observation.start_time) * observation.fps).astype(int)
        within = (number >= 0) & (number < len(moments) + max(0, observation.fps / motion.fps - 1))
        seen[within] |= moments[number[within].clip(max=len(moments) - 1)]
    return seen
