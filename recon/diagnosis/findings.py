"""Findings of checks, as records for reports and as sentences."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Bool

from recon.core.arrays import runs

Data = TypeVar("Data")

Code = Literal[
    "sides exchanged",  # left and right are exchanged, in all frames or in a stretch
    "points exchanged",  # two points carry each other's name
    "identity change",  # another person is seen from some frame on
    "constant point",  # a point stays in place while the body moves
    "zeros",  # points at exactly zero that are marked as seen
    "offset point",  # one point is away from its place on the body throughout
    "rate",  # the number of frames per second is wrong by a factor
    "frame order",  # frames are not in the order of time
    "repeated frames",  # frames occur more than once
    "floor",  # the ground is not at the height that the recording states
    "scale",  # everything is larger or smaller than a person by one factor
    "mirrored",  # the recording is a mirror image
    "outliers",  # many points are far from any body
    "camera moves",  # a camera that is declared fixed moves
    "view at odds",  # one camera contradicts the others, by its pose or by what it shows
    "views out of step",  # one camera's clock is shifted against the others'
    "wrong basin",  # a fit to depth converged to a wrong posture or heading
    "unseen",  # frames or limbs without data; the prior infers them
    "guessed",  # a large part of the body was not seen, and its standard deviation is large
    "undecided",  # another motion explains the data nearly as well
    "treadmill",  # all standing feet move at one velocity
    "no path",  # an estimate has poses, and the same translation in every frame
    "uneven ground",  # feet stand at several heights, or the person sits
    "residual",  # residuals are larger than the noise explains, for an unknown reason
    "body size",  # the fitted height or shape is outside the human range
    "body surface",  # the surfaces of two bodies, between which a motion is transferred, differ
    "distance",  # a camera would be nearer or farther than people are filmed
    "gap",  # a stretch of frames without data
    "few moments",  # moments are so far apart that steps may fall between them
    "jump",  # the fitted body moves faster between two frames than the data
    "joint centres",  # points given as markers lie inside the body, as joints do
    "focal",  # the camera is not calibrated; its focal length was fitted with the motion
    "proposed",  # a network proposed the motion of unseen limbs from which the fit began
    "preview",  # a network proposed the motion, which no fit has refined
    "unfamiliar",  # the data are far from what a network has learned from
    "hand",  # points of a hand are another hand's, mirrored, too few, or of uncertain depth
    "stopped",  # the caller ended the fit before it was done
]
"""The likeliest cause of a finding."""


@dataclass(frozen=True)
class Finding:
    """A repair, warning or diagnosis: its kind, its message and the numbers behind it."""

    code: Code
    message: str
    """A sentence for the user: what was found and what was done or what to do."""
    joints: tuple[str, ...] = ()
    """Names of the points that are concerned, as the recording calls them; empty means all."""
    frames: tuple[tuple[int, int], ...] = ()
    """Stretches of frames, first and last, both included; empty means all."""
    value: float | None = None
    """The number that decided, in SI units or pixels."""
    sensors: tuple[str, ...] = ()
    """Names of the sensors that it speaks of; empty means all."""

    def of(self, sensor: str) -> "Finding":
        """The finding with a sensor's name in its record and at the start of its message."""
        return replace(self, message=f"{sensor}: {self.message}", sensors=(sensor,))

    def report(self) -> dict[str, Any]:
        """The record as it stands in a report's lists `diagnosis`, `repairs` and `warnings`."""
        return asdict(self)


@dataclass(frozen=True)
class Findings:
    """Findings in three lists: diagnosis, repairs and warnings; sums keep the order."""

    repairs: Sequence[Finding] = ()
    """Faults of the data that were put right before the fit."""
    warnings: Sequence[Finding] = ()
    """What should be read before the result is used."""
    diagnosis: Sequence[Finding] = ()
    """What is worth knowing but is no fault."""

    def __add__(self, other: "Findings") -> "Findings":
        """The findings of both records, in their order."""
        return Findings(
            (*self.repairs, *other.repairs),
            (*self.warnings, *other.warnings),
            (*self.diagnosis, *other.diagnosis),
        )

    def of(self, sensor: str) -> "Findings":
        """The findings with a sensor's name in the records and at the start of messages."""
        every = (self.repairs, self.warnings, self.diagnosis)
        return Findings(*(tuple(one.of(sensor) for one in some) for some in every))


NOTHING = Findings()


def run_checks(
    data: Data, checks: Sequence[Callable[[Data], tuple[Data, Findings]]]
) -> tuple[Data, Findings]:
    """The data after a sequence of checks that may repair them, and all findings."""
    found = NOTHING
    for check in checks:
        data, more = check(data)
        found += more
    return data, found


def stretches(
    flags: Bool[np.ndarray, " frames"], least: float | int = 1
) -> tuple[tuple[int, int], ...]:
    """First and last index of every run of at least `least` true values."""
    return tuple((first, stop - 1) for first, stop in runs(flags) if stop - first >= least)


def lasting(flags: Bool[np.ndarray, " frames"], least: float | int) -> Bool[np.ndarray, " frames"]:
    """The flags, true only in runs of at least `least` true values."""
    out = np.zeros_like(flags)
    for first, last in stretches(flags, least):
        out[first : last + 1] = True
    return out


def chosen(names: Sequence[str], flags: Bool[np.ndarray, " names"]) -> tuple[str, ...]:
    """The names whose flag is true."""
    return tuple(name for name, flag in zip(names, flags, strict=True) if flag)


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names as words of a sentence: all of a few, else the first and how many more there are."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def spans(frames: Sequence[tuple[int, int]], most: int = 3) -> str:
    """Ranges of frames as words of a sentence."""
    words = [f"{a}" if a == b else f"{a}-{b}" for a, b in frames]
    noun = "frame" if len(frames) == 1 and frames[0][0] == frames[0][1] else "frames"
    return f"{noun} {listed(words, most)}"
