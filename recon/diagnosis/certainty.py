"""Standard deviations of every joint, from the curvature of the fit's objective."""

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.angles import isb_slopes
from recon.body.contacts import contact_probabilities, rest_heights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import Unit
from recon.core.skeleton import JOINTS
from recon.fitting.clip import GROUND_DEVIATION
from recon.fitting.records import ClipFit
from recon.method.derivatives import GroundBelief
from recon.method.laplace import Deviations, Measure, deviations
from recon.method.sensor import frame_is_level, views_of

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
