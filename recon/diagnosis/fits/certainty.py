"""How sure a fit is of every joint, from the curvature of its objective."""

from dataclasses import asdict, replace
from typing import Any

import torch

from recon.core.residuals import Noise, Unit
from recon.core.skeleton import JOINTS
from recon.diagnosis.fits.angles import angles_of
from recon.diagnosis.fits.size import size_is_unknown, with_unknown_size
from recon.fitting.clip import GROUND_DEVIATION, ClipFit
from recon.formats.results.certainty import JointCertainty
from recon.method.laplace.deviations import Believing, Deviations, deviations
from recon.method.laplace.grounds import GroundBelief, GroundDeviation
from recon.method.priors import traits_of
from recon.method.protocols import Estimate, Sensor

_WORTH: dict[Unit, float] = {"metres": 4.0, "pixels": 1.0}
"""Independent observations that one in this unit is worth. Priors smooth more than the density
that stands for them says, so errors are smaller than its curvature promises; chosen on validation
people so that 90 % of the errors of seen joints lie within 1.645 standard deviations."""
_CLOUD_WORTH = 0.05
"""What a patch of a cloud's surface in one frame is worth, chosen likewise: what a body of other
flesh and clothes misses stays the same over many frames."""
_STANCE = 0.03
"""Metres by which standing feet miss the ground, clip by clip."""
_UPRIGHT = 0.04
"""Radians by which people lean on average over a clip, beside what a prior knows of gravity."""
_UPRIGHT_ALONE = 0.09
"""Radians likewise where the ground is only put below people, by priors that know no gravity."""


def certainty(found: ClipFit) -> Deviations | None:
    """Standard deviations of a fit's joints; None where its prior has no density to bend.

    Clouds are thinned first: neighbouring points err alike.
    """
    estimate = found.result.estimate
    prior = found.result.reports[-1].stage.prior
    if not isinstance(prior, Believing) or found.result.failed[0]:
        return None
    seen, noises = [], []
    for one, noise in zip(found.observations, found.noises, strict=True):
        thin, noise, worth = _thinned(one, noise, estimate)
        seen.append(thin)
        noises.append(replace(noise, own=noise.own / worth**0.5))
    least = min(noise.metres for noise in found.noises)
    with torch.no_grad():
        try:
            body = estimate.body.model.to(device="cpu", dtype=torch.float64)
            known = deviations(
                estimate, seen, noises, prior.belief(least), _ground(found), angles_of(body)
            )
        except RuntimeError:  # a Hessian that is singular to rounding has no inverse
            return None
        return with_unknown_size(known, found) if size_is_unknown(found) else known


def _ground(found: ClipFit) -> GroundBelief | None:
    """What is believed of the ground; None where there is none."""
    if not found.grounded:
        return None
    if found.ground_known:
        return GroundBelief(_STANCE, _UPRIGHT, 0)
    level = all(one.level for one in found.observations)
    shown = GROUND_DEVIATION**-2 if found.ground_seen else 0.0
    knows = traits_of(found.result.reports[-1].stage.prior).knows_gravity
    upright = _UPRIGHT if knows else _UPRIGHT_ALONE
    return GroundBelief(_STANCE, upright, 1 if level else 3, shown)


def _thinned(one: Sensor, noise: Noise, estimate: Estimate) -> tuple[Sensor, Noise, float]:
    """The sensor with fewer points where it is a cloud, and what one of its points is worth."""
    body = estimate.body.model
    if one.point_names(body):
        return one, noise, _WORTH.get(one.unit, 1.0)
    thin = one.coarse(body)
    return thin, thin.noise(estimate.motion, body, noise.metres), _CLOUD_WORTH


def certainty_report(deviations: Deviations, joints: JointCertainty | None) -> dict[str, Any]:
    """Standard deviations as a report has them: medians of joints and root, shape, ground."""
    every = deviations.joints.median(0).values.tolist()
    ground = deviations.ground
    return {
        **({} if joints is None else asdict(joints)),
        **({} if ground is None else {"ground": _ground_report(ground)}),
        "joints": dict(zip(JOINTS, every, strict=True)),
        "root": float(deviations.root.median()),
        "shape": deviations.shape.tolist(),
    }


def _ground_report(ground: GroundDeviation) -> dict[str, float]:
    return {"normal_degrees": ground.normal_degrees, "height": ground.height}
