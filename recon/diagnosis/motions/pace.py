"""Whether the declared frame rate can be true, by the laws of gait and of gravity."""

import math
from dataclasses import dataclass

from jaxtyping import Bool
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding
from recon.diagnosis.motions.gravity import rates_by_balance, rates_by_falls
from recon.diagnosis.motions.movement import Movement
from recon.diagnosis.motions.strides import rates_by_strides, strides

_LEAST_SECONDS = 0.4
_USUAL = (0.25, 0.5, 2.0, 4.0)
"""Factors by which rates are wrong in practice: every second or fourth frame was left out."""


@dataclass(frozen=True)
class RateRange:
    """The range of the true frame rate, as multiples of the declared one."""

    low: float
    high: float
    evidence: tuple[str, ...]
    """What the bounds follow from, in words."""

    @property
    def holds(self) -> bool:
        """Whether the declared rate is among those that are possible."""
        return self.low <= 1 <= self.high

    @property
    def likeliest(self) -> float:
        """The factor in the range that is usual in practice and nearest to one, or its middle."""
        inside = [f for f in _USUAL if self.low <= f <= self.high]
        if self.holds or not inside:
            near = self.high if self.high < 1 else self.low
            return 1.0 if self.holds else near
        return min(inside, key=lambda factor: abs(math.log(factor)))


def rate_range(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> RateRange | None:
    """What a motion's gait, falls and balance say of its frame rate; None where they say nothing.

    Args:
        motion: one clip on the ground z = 0 or any other level one, without a batch axis.
        body: whose motion it is.
        observed: joints that the data shows; what is inferred obeys the rate that was declared.
    """
    movement = Movement.of(motion, body, observed)
    if movement.seconds < _LEAST_SECONDS:
        return None
    found = strides(movement)
    bounds = {
        "the length of its steps for their duration": (0.0, math.inf)
        if found is None
        else rates_by_strides(found),
        "the acceleration of its falls against gravity": rates_by_falls(movement),
        "the balance of its centre of mass over its feet": rates_by_balance(movement),
    }
    told = {why: bound for why, bound in bounds.items() if bound != (0.0, math.inf)}
    if not told:
        return None
    low = max(bound[0] for bound in told.values())
    high = min(bound[1] for bound in told.values())
    if low > high:
        # the laws contradict each other: what was found is no error of the rate alone
        return None
    against = tuple(why for why, bound in told.items() if not bound[0] <= 1 <= bound[1])
    return RateRange(low, high, against or tuple(told))


def rate_finding(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> Finding | None:
    """A warning that the frame rate is wrong by a factor, or None where it can be true."""
    found = rate_range(motion, body, observed)
    if found is None or found.holds:
        return None
    factor = found.likeliest
    way = "fast" if found.high < 1 else "slow"
    bounds = f"at most {found.high:.2g}" if found.high < 1 else f"at least {found.low:.2g}"
    return Finding(
        "rate",
        f"at {motion.fps:g} frames per second the person moves too {way}: "
        f"{' and '.join(found.evidence)} asks for {bounds} times that rate. Check the frame rate; "
        f"it is likely about {motion.fps * factor:.3g}",
        value=factor,
    )
