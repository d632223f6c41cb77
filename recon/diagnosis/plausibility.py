"""What a fitted person says about the input: size and soles; in words."""

from recon.body.model import ODDEST, SHORTEST_BODY, TALLEST_BODY
from recon.body.soles import sole_heights
from recon.diagnosis.findings import Finding
from recon.fitting.fitted import ClipFit
from recon.method.sensor import views_of

_ODDEST, _ODDEST_MARKERS = 1.5 * ODDEST, 15.0
"""Standard deviations of shape beyond which a fit is no person's. Noise and acrobatics add to what
people differ by, and real markers stand off the skin or beside the landmark that they are named
after: good recordings reach 14. Wrong units and scales are told by the height."""
_SHORTEST_CHILD = 0.95
"""Metres; smaller children do not walk on command."""
_OFF_GROUND = 0.15
"""Metres between the soles that stand and the ground."""


def body_warnings(found: ClipFit) -> list[Finding]:
    """Wrong focal lengths, units and poses of cameras make nobody's body, or one that floats.

    Where no camera and no ground tells sizes, the prior does, and nothing can be said.
    """
    posed = found.result.estimate.body
    tall = float(posed.model.height(posed.shape.detach()).mean())
    warnings: list[Finding] = []
    if not SHORTEST_BODY < tall < TALLEST_BODY and not _is_child(found, tall):
        warnings.append(
            Finding(
                "body size",
                f"the person would be {tall:.2f} m tall; check {_sizes(found)} (for a child this "
                "is as well as an adult body can do)",
                value=tall,
            )
        )
    elif (odd := float(posed.shape.abs().max())) > _oddest(found):
        warnings.append(
            Finding(
                "body size",
                f"the person's shape is {odd:.1f} standard deviations from the average; check "
                f"{_sizes(found)}",
                value=odd,
            )
        )
    if found.ground_known:
        soles = float(sole_heights(found.result.motion, posed.model).median())
        if abs(soles) > _OFF_GROUND:
            warnings.append(
                Finding(
                    "floor",
                    f"the soles stand at {soles:.2f} m, but the ground is at 0; check focal "
                    "lengths, image sizes and the heights of the cameras, unless the person "
                    "stands or sits on something",
                    value=soles,
                )
            )
    return warnings


def child_findings(found: ClipFit) -> list[Finding]:
    """Points in metres that a small body fits show a child, which is no fault of the data."""
    posed = found.result.estimate.body
    tall = float(posed.model.height(posed.shape.detach()).mean())
    if not _is_child(found, tall):
        return []
    return [
        Finding(
            "body size",
            f"the person is {tall:.2f} m tall: a child, whose proportions an adult body meets "
            "only roughly. If it is an adult, check the unit and the scale of the points",
            value=tall,
        )
    ]


def _is_child(found: ClipFit, tall: float) -> bool:
    """Whether points that are measured in metres show somebody as small as children are."""
    return not views_of(found.observations) and _SHORTEST_CHILD < tall <= SHORTEST_BODY


def _sizes(found: ClipFit) -> str:
    """What tells the size of a body, for messages."""
    if views_of(found.observations):
        return "focal lengths, units and the poses of the cameras"
    return "the unit, the scale and the labels of the points"


def _oddest(found: ClipFit) -> float:
    """Standard deviations from which on a shape is odd; markers beside the skin bend it."""
    return (
        _ODDEST_MARKERS
        if any(one.named and one.named.on_skin for one in found.observations)
        else _ODDEST
    )
