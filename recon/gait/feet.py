"""Heels, toes and pelvis of a motion over time, and the stances of its feet."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.movement import facing_directions

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
"""Order of the sides wherever an axis has two."""
CUTOFF_HZ = 12.0
"""Frequency above which the paths of feet are noise. Lower limits, which are common for
coordinates of walking, blur the moment of the strike: 7 Hz tripled the deviation from marked
events."""

_SOLES = tuple((joint_index(f"{side}_ankle"), joint_index(f"{side}_foot")) for side in SIDES)


@dataclass(frozen=True)
class Feet:
    """Feet and pelvis of one clip over time, relative to the ground or belt; metres, z up.

    On a treadmill that is the belt, in whose frame the person walks ahead.
    """

    heels: Float[np.ndarray, "time 2 3"]
    """Back of the left and of the right heel."""
    toes: Float[np.ndarray, "time 2 3"]
    """Base of the second toe, left and right."""
    pelvis: Float[np.ndarray, "time 3"]
    """Joint in the middle of the pelvis."""
    forward: Float[np.ndarray, "time 2"]
    """Horizontal direction that the pelvis faces, a unit vector."""
    bearing: Bool[np.ndarray, "time 2"] | None
    """Whether a foot is in contact with the ground; None where there is no ground."""
    times: Float[np.ndarray, " time"]
    """Seconds of the recording's clock."""
    fps: float

    @classmethod
    def of(
        cls,
        motion: Motion,
        body: BodyModel,
        ground: float | None = 0.0,
        belt: Float[Tensor, " 2"] | None = None,
    ) -> "Feet":
        """Positions of a motion's feet, low-pass filtered at 12 Hz without delay.

        Args:
            motion: one clip without a batch axis.
            body: whose motion it is; the bundled one, whose heels and toes are known.
            ground: height of the ground, metres; None where there is none.
            belt: velocity of a treadmill's belt in the room, m/s; None where the ground rests.

        Raises:
            ReconError: when the body is another one, or the clip a single frame.
        """
        if motion.frames < 2:
            raise ReconError("gait has speeds, and so two frames or more; the motion has one")
        if body.checksum != BodyModel.load().checksum:
            raise ReconError(
                "gait analysis needs heels and toes, which are known only for the bundled body, "
                f"not for {body.name!r}: give a motion of the bundled body"
            )
        posed = body.pose(motion.detach())
        times = motion.times.double().cpu()
        path = torch.zeros(len(times), 3, dtype=torch.float64)
        if belt is not None:
            path[:, :2] = (times - times[0])[:, None] * belt.double().cpu()
        joints = posed.joints.double().cpu() - path[:, None]
        points = torch.tensor([landmark(f"{s}_{n}") for n in ("heel", "toe2_base") for s in SIDES])
        skin = posed.points(points).double().cpu() - path[:, None]
        bearing = None
        if ground is not None:
            above = joints - joints.new_tensor([0.0, 0.0, ground])
            heights = rest_heights(body, motion.shape).double().cpu()
            labels = contact_labels(above, heights, motion.fps).numpy()
            bearing = np.stack([labels[:, list(sole)].any(-1) for sole in _SOLES], -1)
        smooth = low_passed(skin.numpy(), motion.fps)
        return cls(
            heels=smooth[:, :2],
            toes=smooth[:, 2:],
            pelvis=low_passed(joints[:, 0].numpy(), motion.fps),
            forward=facing_directions(low_passed(joints.numpy(), motion.fps)),
            bearing=bearing,
            times=times.numpy(),
            fps=motion.fps,
        )


def low_passed(values: Float[np.ndarray, "time ..."], fps: float) -> Float[np.ndarray, "time ..."]:
    """Return values after a 12 Hz low-pass (second-order Butterworth, forwards and backwards).

    Values at 24 Hz or less, and 12 values or fewer, are returned unfiltered.
    """
    from scipy.signal import butter, sosfiltfilt

    if fps <= 2 * CUTOFF_HZ or len(values) <= 12:
        return values
    sections = butter(2, CUTOFF_HZ, fs=fps, output="sos")
    return sosfiltfilt(sections, values, axis=0, padlen=min(len(values) - 1, round(fps / 2)))


MIN_STRIDE_S = 0.3
"""Least time between two strikes of one foot, seconds."""
MIN_SWING_M = 0.12
"""Least distance that a foot goes back and forth below the pelvis in a step, metres."""
LEAVING_M_S = 0.8
"""Speed, metres per second, from which on toes have left the ground: of the events that five
people's laboratory marked in C3D files, this speed is nearest (0 ± 14 ms)."""
MIN_SWING_SHARE = 0.35
"""Share of its largest swing that a foot must make in each."""
SWING_S = 0.4
"""Seconds before a strike, or after the toes left, in which the foot swings."""
BEFORE_S, AFTER_S = 0.03, 0.12
"""Seconds around the moment of the heel farthest ahead in which the foot strikes."""


@dataclass(frozen=True)
class GaitStance:
    """One stance of a foot, from its strike to toe-off."""

    side: Side
    strike: int | None
    """Frame of the strike; None where the recording begins later."""
    off: int | None
    """Frame at which the toes leave; None where the recording ends before."""

    def frames(self, count: int) -> range:
        """The frames of this stance, within the `count` frames of the recording."""
        first = 0 if self.strike is None else self.strike
        return range(first, count if self.off is None else self.off + 1)


def find_stances(feet: Feet) -> tuple[GaitStance, ...]:
    """All stances of both feet in time order; the first and last may lack an event."""
    count = len(feet.times)
    found = [stance for side in range(2) for stance in _stances_of_foot(feet, side)]

    def time_and_side(stance: GaitStance) -> tuple[int, Side]:
        frames = stance.frames(count)
        return frames.start + frames.stop, stance.side

    return tuple(sorted(found, key=time_and_side))


def _stances_of_foot(feet: Feet, side: int) -> list[GaitStance]:
    strikes = _strike_frames(
        feet, side, _peak_frames(_distance_ahead(feet, feet.heels[:, side]), feet.fps)
    )
    offs = _toe_off_frames(
        feet, side, _peak_frames(-_distance_ahead(feet, feet.toes[:, side]), feet.fps)
    )
    events = sorted([(k, "strike") for k in strikes] + [(k, "off") for k in offs])
    found: list[GaitStance] = []
    if events and events[0][1] == "off":
        found.append(GaitStance(SIDES[side], None, events[0][0]))
    for (frame, kind), (after, then) in pairwise([*events, (None, "end")]):
        if kind == "strike":
            found.append(GaitStance(SIDES[side], frame, after if then == "off" else None))
    if feet.bearing is None:
        return found
    # intervals in which the foot never bears weight are no stances
    bearing = feet.bearing[:, side]
    return [one for one in found if bool(bearing[list(one.frames(len(bearing)))].any())]


def _distance_ahead(feet: Feet, points: Float[np.ndarray, "time 3"]) -> Float[np.ndarray, " time"]:
    return ((points - feet.pelvis)[:, :2] * feet.forward).sum(-1)


def _peak_frames(values: Float[np.ndarray, " time"], fps: float) -> Int[np.ndarray, " peaks"]:
    """Return the frames of a signal's local maxima; near the ends, one rising side is enough."""
    from scipy.signal import find_peaks

    swing = float(np.quantile(values, 0.98) - np.quantile(values, 0.02))
    least = max(MIN_SWING_M, MIN_SWING_SHARE * swing)
    padded = np.pad(values, 1, constant_values=float(values.min()) - 2 * least)
    found = find_peaks(padded, prominence=least, distance=max(1, round(MIN_STRIDE_S * fps)))[0] - 1
    # at the first or last frame the true maximum may lie outside the data
    return found[(found > 0) & (found < len(values) - 1)]


def _strike_frames(feet: Feet, side: int, step_peaks: Int[np.ndarray, " steps"]) -> list[int]:
    """Return the frames at which a foot strikes the ground.

    A strike is where the foot falls fastest, near the frame with the heel farthest ahead.

    The foot must have swung before: a heel may be farthest ahead while the person still stands.
    """
    swings = _toe_speeds(feet, side) > LEAVING_M_S
    middle = (feet.heels[:, side, 2] + feet.toes[:, side, 2]) / 2
    rise = np.gradient(middle) * feet.fps
    found: list[int] = []
    for frame in step_peaks.tolist():
        first = max(0, frame - round(BEFORE_S * feet.fps))
        last = min(len(rise), frame + round(AFTER_S * feet.fps) + 1)
        strike = first + int(np.argmin(rise[first:last]))
        if swings[max(0, strike - round(SWING_S * feet.fps)) : strike + 1].any():
            found.append(strike)
    return found


def _toe_off_frames(feet: Feet, side: int, behind_peaks: Int[np.ndarray, " steps"]) -> list[int]:
    """Frames of toe-off: the end of the toes' rest before or while they are farthest behind.

    The foot must swing then: toes may be farthest behind while the person goes on standing.
    """
    rests = _toe_speeds(feet, side) < LEAVING_M_S
    found: list[int] = []
    for frame in behind_peaks.tolist():
        # toe-off is when toes that stood still, until they were farthest behind the body, move on
        after = np.flatnonzero(~rests[frame : frame + round(SWING_S * feet.fps)])
        if len(after) == 0:
            continue
        first = frame + int(after[0])
        before = np.flatnonzero(rests[:first])
        found.append(int(before[-1]) + 1 if len(before) > 0 else first)
    return found


def _toe_speeds(feet: Feet, side: int) -> Float[np.ndarray, " time"]:
    """Speed of the toes over the ground, m/s."""
    velocity = np.gradient(feet.toes[:, side], axis=0) * feet.fps
    return np.linalg.norm(velocity, axis=-1)
