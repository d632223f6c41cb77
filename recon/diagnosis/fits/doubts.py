"""What a fit is unsure of: parts of the body that are merely guessed, motions nearly as likely."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from recon.core.skeleton import JOINTS
from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.diagnosis.fits.alternatives import Alternative

GUESSED = 0.1
"""Standard deviation of a coordinate, metres, from which on a joint is merely guessed: as far as
its neighbours along a limb are apart."""
_PART = 0.25
"""Share of the joints of a frame that are a large part of the body."""
_SHORTEST = 0.2
"""Seconds that are worth a word."""
NEARLY = 0.15
"""Share of the energy by which another motion may be worse and still be nearly as likely. On
five validation windows of depth alone, where all headings were chosen well, the next was worse by
29 % at least."""
_ANOTHER = 0.15
"""Metres, mean of joints, from which on another posture is another motion: quick fits that compare
first guesses leave smaller differences to the fit that follows."""


def guessed_findings(
    joint_std: Float[np.ndarray, "time 22"], observed: Bool[np.ndarray, "time 22"], fps: float
) -> list[Finding]:
    """Stretches in which a large part of the body that nobody saw may be anywhere near.

    Joints that were seen are left out: what one camera cannot tell of their distance is no guess.

    Args:
        joint_std: standard deviation of a coordinate of every joint, metres.
        observed: false where a joint was inferred rather than seen.
        fps: frames per second.
    """
    loose = (joint_std > GUESSED) & ~observed
    flags = loose.mean(1) >= _PART
    if flags.sum() < _SHORTEST * fps:
        return []
    often = loose[flags].mean(0) > 0.5
    names = tuple(name for name, one in zip(JOINTS, often, strict=True) if one)
    typical = float(np.median(joint_std[flags][loose[flags]]))
    frames = stretches(flags)
    return [
        Finding(
            "guessed",
            f"{listed(names) if names else 'much of the body'} may be anywhere within some "
            f"{200 * typical:.0f} cm in {int(flags.sum())} of {len(flags)} frames "
            f"({spans(frames)}): nothing seen holds them (`joint_std` in the motion file)",
            names,
            frames,
            typical,
        )
    ]


def undecided_findings(alternatives: Sequence[Alternative]) -> list[Finding]:
    """The likeliest other motion, where it explains the data nearly as well."""
    close = [
        one
        for one in alternatives
        if one.excess < NEARLY and (one.kind != "posture" or one.distance > _ANOTHER)
    ]
    if not close:
        return []
    more = f" and {len(close) - 1} more" if len(close) > 1 else ""
    return [
        Finding(
            "undecided",
            f"another motion explains the data nearly as well: {close[0]}{more}; look at both, "
            "or add a sensor that tells them apart (`alternatives` in the report)",
            value=close[0].excess,
        )
    ]
