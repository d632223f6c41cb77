"""The report on a completed gait cycle, with warnings for motions that are not one."""

from collections.abc import Sequence
from typing import Any

from recon.body.cycles import find_cycles
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding
from recon.fitting.records import ClipFit, seen_moments
from recon.method.cycle_prior import CyclePrior

SWING = 0.3
"""Largest difference of a completed cycle's hips from those of gait, as `find_cycles` measures it.
Of the cycles that it finds in the validation motions, 96 % are below, and the others are people
who stand; all completions of motions without cycles were above."""

_COVERED = 0.75
"""Share of the completed motion that this cycle must be."""
_ANYTHING = 2.0
"""Difference of hips that have nothing to do with gait."""
_FEW_MOMENTS = 4
"""Number of frames seen below which most of the motion is the prior's."""


def cycle_report(
    found: ClipFit, residual_medians: Sequence[float | None]
) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return numbers that describe a completed gait cycle, and warnings if it may be none.

    The prior makes something like a cycle of anything. Latent codes do not show that:
    people who stand have codes like those who walk. Hips do: one cycle of gait takes them once
    through their swing, and back.

    `code_distance` is half the squared Mahalanobis distance of the code from those of recorded
    cycles, per dimension; recorded cycles have 0.5, completed ones less, as little is seen of
    them. `swing_difference` is that of `SWING`, null where the hips do not even return.

    Args:
        found: by `recon.fitting.cycles.complete`.
        residual_medians: of its observations, metres; None where nothing was seen.
    """
    motion = found.result.clip(0).detach()
    prior = found.result.reports[-1].stage.prior
    assert isinstance(prior, CyclePrior)
    latent = found.result.estimate.decoded.energies["latent"][0]
    moments = seen_moments(found.observations)
    difference = swing_difference_from_textbook(motion)
    numbers = {
        "seconds": motion.duration,
        "moments_seen": len(moments),
        "code_distance": float(latent) / prior.code_size,
        "swing_difference": difference,
        "residual_mm": [None if one is None else 1000 * one for one in residual_medians],
        "details": any(report.stage.name == "details" for report in found.result.reports),
    }
    warnings: list[Finding] = []
    if difference is None or difference > SWING:
        warnings.append(
            Finding(
                "residual",
                "this is no cycle of gait, which is all that the prior knows: the hips do not go "
                "through one swing and back. Cut one cycle out (--between), or fit with another "
                "prior",
                value=difference,
            )
        )
    if len(moments) < _FEW_MOMENTS:
        warnings.append(
            Finding(
                "gap",
                f"something is seen at {len(moments)} moments only; what happens between them is "
                "a guess of the prior",
                value=float(len(moments)),
            )
        )
    if not all(one.ground_known for one in found.observations):
        message = "nothing tells where the ground is; it was taken to be at z = 0"
        warnings.append(Finding("floor", message))
    return numbers, tuple(warnings)


def swing_difference_from_textbook(motion: Motion) -> float | None:
    """Return how far hip flexion is from textbook gait; None if no cycle fills the motion."""
    min_seconds = _COVERED * motion.duration
    costs = [one.cost for one in find_cycles(motion, _ANYTHING) if one.duration >= min_seconds]
    return min(costs, default=None)
