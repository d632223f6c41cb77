"""Joints that were seen, frame by frame, as against joints that a prior inferred."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int

from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.method.protocols import Estimate, Sensor

_NEAR = 0.2
"""Metres at rest within which a point on a neighbouring bone shows where a joint is."""


def observed_joints(
    observations: Sequence[Sensor], estimate: Estimate
) -> Bool[np.ndarray, "time 22"]:
    """The joints that some sensor saw, for every frame of the first clip's motion.

    A joint is seen where a visible point lies within 20 cm of it at rest and on a bone that ends
    or begins there; or where points of a cloud lie within 15 cm of it.
    """
    motion = estimate.motion
    seen = np.zeros((motion.frames, len(JOINTS)), dtype=bool)
    for observation in observations:
        moments = observation.shown_joints(estimate)
        number = _nearest_moments(observation, motion)
        within = (number >= 0) & (number < len(moments))
        seen[within] |= moments[number[within]]
    return seen


def unseen_findings(observed: Bool[np.ndarray, "time 22"]) -> list[Finding]:
    """Joints that were never seen, and frames in which nothing was seen, as said to the user."""
    found: list[Finding] = []
    never = tuple(
        name for name, some in zip(JOINTS, np.any(observed, axis=0), strict=True) if not some
    )
    if never:
        found.append(
            Finding(
                "unseen",
                f"{listed(never)} {'was' if len(never) == 1 else 'were'} never seen; the prior "
                "inferred them (`observed` in the motion file)",
                never,
                value=len(never) / len(JOINTS),
            )
        )
    empty = ~np.any(observed, axis=1)
    if empty.any():
        found.append(
            Finding(
                "gap",
                f"nothing was seen in {int(empty.sum())} of {len(empty)} frames "
                f"({spans(stretches(empty))}); the motion there is inferred",
                (),
                stretches(empty),
                float(empty.mean()),
            )
        )
    return found


def _nearest_moments(observation: Sensor, motion: Motion) -> Int[np.ndarray, " time"]:
    """The number of the nearest tick of the observation's clock, for every frame of the motion.

    Frames before its first and after its last moment have numbers beyond its own.
    """
    times = motion.start_time + np.arange(motion.frames) / motion.fps
    return np.rint((times - observation.start_time) * observation.fps).astype(int)
