"""The records in which checks report faults and notes, and helpers to phrase them."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Bool

from recon.core.arrays import runs_of_true

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
    "distance",  # the fit puts a camera nearer or farther than people are filmed from
    "gap",  # a stretch of frames without data
    "few moments",  # so few frames a second were seen that footsteps between them may be missed
    "jump",  # the fitted body moves faster between two frames than the observed points do
    "joint centres",  # points given as markers lie inside the body, as joints do
    "focal",  # the camera is not calibrated; its focal length was fitted with the motion
    "proposed",  # a network proposed the motion of unseen limbs from which the fit began
    "preview",  # a network proposed the motion, which no fit has refined
    "unfamiliar",  # the data are far from what a network has learned from
    "hand",  # points of a hand are another hand's, mirrored, too few, or of uncertain depth
    "stopped",  # the caller ended the fit before it was done
]
"""Kind of a finding, by its likeliest cause."""


@dataclass(frozen=True)
class Finding:
    """A repair, warning or diagnosis: its kind, its message and the numbers behind it."""

    code: Code
    message: str
    """A sentence for the user: what was found and what was done or what to do."""
    joints: tuple[str, ...] = ()
    """Names of the points concerned, as in the recording; empty means all."""
    frames: tuple[tuple[int, int], ...] = ()
    """First and last frame (inclusive) of each stretch concerned; empty means all."""
    value: float | None = None
    """The number that was compared with a limit, in SI units or pixels."""
    sensors: tuple[str, ...] = ()
    """Names of the sensors concerned; empty means all."""

    def of_sensor(self, sensor: str) -> "Finding":
        """Return the finding with a sensor's name in its record and before its message."""
        return replace(self, message=f"{sensor}: {self.message}", sensors=(sensor,))

    def report(self) -> dict[str, Any]:
        """Return the record as it stands in the report's lists of findings."""
        return asdict(self)


@dataclass(frozen=True)
class Findings:
    """Findings in three lists: repairs, warnings and diagnosis; `+` appends them in order."""

    repairs: Sequence[Finding] = ()
    """Faults of the data that were repaired before the fit."""
    warnings: Sequence[Finding] = ()
    """Findings that should be read before the result is used."""
    diagnosis: Sequence[Finding] = ()
    """Findings that are worth knowing but are no fault."""

    def __add__(self, other: "Findings") -> "Findings":
        """Return the findings of both records, in their order."""
        return Findings(
            (*self.repairs, *other.repairs),
            (*self.warnings, *other.warnings),
            (*self.diagnosis, *other.diagnosis),
        )

    def of_sensor(self, sensor: str) -> "Findings":
        """Return the findings with a sensor's name in the records and before the messages."""
        every = (self.repairs, self.warnings, self.diagnosis)
        return Findings(*(tuple(one.of_sensor(sensor) for one in some) for some in every))


NOTHING = Findings()


def run_checks(
    data: Data, checks: Sequence[Callable[[Data], tuple[Data, Findings]]]
) -> tuple[Data, Findings]:
    """Run checks one after the other on data that they may repair; return both results."""
    found = NOTHING
    for check in checks:
        data, more = check(data)
        found += more
    return data, found


def stretches(
    flags: Bool[np.ndarray, " frames"], least: float | int = 1, ratio: float = 1.0
) -> tuple[tuple[int, int], ...]:
    """Return first and last index, times `ratio`, of every run of at least `least` true values."""
    return tuple(
        (round(first * ratio), max(round(first * ratio), round(stop * ratio) - 1))
        for first, stop in runs_of_true(flags)
        if stop - first >= least
    )


def long_runs(flags: Bool[np.ndarray, " time"], least: float | int) -> Bool[np.ndarray, " time"]:
    """Return a mask that is true only in runs of at least `least` true values."""
    out = np.zeros_like(flags)
    for first, last in stretches(flags, least):
        out[first : last + 1] = True
    return out


def flagged(names: Sequence[str], flags: Bool[np.ndarray, " names"]) -> tuple[str, ...]:
    """Return the names whose flag is true."""
    return tuple(name for name, flag in zip(names, flags, strict=True) if flag)


def listed(names: Sequence[str], most: int = 4) -> str:
    """Join names by commas; of more than `most`, give the first ones and count the others."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def spans(frames: Sequence[tuple[int, int]], most: int = 3) -> str:
    """Write ranges of frames as words of a sentence, such as "frames 3-7, 12"."""
    words = [f"{a}" if a == b else f"{a}-{b}" for a, b in frames]
    noun = "frame" if len(frames) == 1 and frames[0][0] == frames[0][1] else "frames"
    return f"{noun} {listed(words, most)}"
