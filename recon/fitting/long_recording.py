"""Cuts one long recording into windows: data, first guess and neighbours of each."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby

import torch
from jaxtyping import Float
from torch import Tensor

from observations.points import quadratic_model
from recon.body.derivatives import BonePoints
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import squared
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.quadratic import PointModel
from recon.method.sensor import Sensor
from recon.method.timing import at_observation_times
from recon.method.windows import Windows, smooth_ramp

AT_ONCE = 6
"""Number of windows fitted as one batch, so that memory does not grow with the recording."""

_MIN_FRAMES = 12
"""Least number of frames of a window."""
_MAX_STEP_S = 0.2
"""Time (s) within which a recording's frames must coincide with those at 30 Hz for windows to
begin there; where they do not, results at 30 Hz are interpolated."""
_CLOCK_DIGITS = 6
"""Number of decimal digits of a second to which clocks are compared."""


@dataclass(frozen=True)
class OverlapEnergy(TensorStruct):
    """Energy ½ Σ w |p - p̂|² (m², 30 Hz) of joints p from the neighbouring windows' joints p̂."""

    joints: Float[Tensor, "*batch time 22 3"]
    """Joints of the neighbours (m) from the window's first frame on; zero where the weight is."""
    weight: Float[Tensor, "*batch time"]
    """The neighbour's share in the joined motion, from one at its inside to zero at its border."""
    fps: float

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Return the energy over the estimated frames; the window's clock begins at zero."""
        joints, seen = at_observation_times(
            estimate.body.joints, estimate.motion,
            fps=self.fps, start_time=0.0, moments=self.joints.shape[-3],
        )  # fmt: skip
        away = (joints - self.joints[..., seen, :, :]).square().sum((-1, -2))
        return 0.5 * (self.weight[..., seen] * away).sum(-1) * (REFERENCE_FPS / self.fps)

    @property
    def start_time(self) -> float:
        """Start of the window on its own clock (s), which is zero."""
        return 0.0

    @property
    def moments(self) -> int:
        """Number of frames of the window."""
        return self.joints.shape[-3]

    def point_model(self, points: Float[Tensor, "*batch time 22 3"]) -> PointModel:
        """Return a quadratic approximation of the energy near predicted joints (m)."""
        weights = self.weight[..., None].expand(self.joints.shape[:-1]).sqrt()
        rate = REFERENCE_FPS / self.fps
        return quadratic_model(points, self.joints, weights, squared, rate)

    def points_on_bones(
        self, body: BodyModel, shape: Float[Tensor, " shape"], offsets: Float[Tensor, "rows 3"]
    ) -> BonePoints:
        """Describe the joints as points attached to a body of a given shape."""
        del offsets
        return BonePoints.of_joints(body, shape)


@dataclass(frozen=True)
class LongRecording:
    """Observations of one clip and its first guess, cut into windows."""

    observations: Sequence[Sensor]
    guess: Motion
    """First guess of the whole motion, without a batch axis."""
    windows: Windows

    @classmethod
    def cut_into_windows(
        cls,
        observations: Sequence[Sensor],
        body: BodyModel,
        window: float,
        overlap: float,
        start: Motion | None = None,
    ) -> "LongRecording":
        """Cut into windows of `window` seconds that begin at multiples of 1/30 s where possible.

        Raises:
            ValueError: when there is no observation or not exactly one clip, one of them cannot
                be cut, or the overlap is none or more than 40 % of a window.
        """
        if len(observations) == 0:
            raise ValueError("nothing to fit: expected at least one observation, got none")
        for observation in observations:
            if not hasattr(observation, "window"):
                raise ValueError(
                    f"{type(observation).__name__} cannot be cut into windows: give it a method "
                    "window(start, stop), or fit the recording in one piece"
                )
        with torch.no_grad():
            guess = observations[0].start(body) if start is None else start
        if guess.translation.shape[:-2] != (1,):
            raise ValueError(
                "expected one clip: a first guess with translations of shape (1, time, 3); got "
                f"{tuple(guess.translation.shape)}; fit long clips one after the other"
            )
        # at a low frame rate a window of this duration has few frames
        longest = max(round(window * guess.fps) + 1, _MIN_FRAMES)
        shared = max(round(overlap * guess.fps), 1)
        windows = Windows.cover(guess.frames, longest, shared, frames_to_common_time(guess.fps))
        return cls(observations, guess[0], windows)

    def time_range(self, row: int) -> tuple[float, float]:
        """Return the times (s) of a window's first and last frame."""
        start = self.guess.start_time + self.windows.starts[row] / self.guess.fps
        return start, start + (self.windows.frames - 1) / self.guess.fps

    def first_guess(self, row: int, shape: Float[Tensor, " shape"]) -> Motion:
        """Return a window's first guess, with the given shape and a clock that begins at zero."""
        first = self.windows.starts[row]
        motion = self.guess.window(first, first + self.windows.frames)
        return motion.replace(start_time=0.0, shape=shape)

    def observations_of(self, row: int) -> tuple[Sensor, ...]:
        """Return a window's observations on a clock that begins at zero."""
        start, stop = self.time_range(row)
        parts = [observation.window(start, stop) for observation in self.observations]
        return tuple(
            p.derived(start_time=round(p.start_time - start, _CLOCK_DIGITS)) for p in parts
        )

    def batches_of_equal_clocks(self, rows: Sequence[int]) -> Iterator[list[int]]:
        """Yield batches of windows whose observations begin at equal times after the start."""

        def clocks(row: int) -> tuple[float, ...]:
            return tuple(part.start_time for part in self.observations_of(row))

        for _, group in groupby(sorted(rows, key=clocks), clocks):
            alike = list(group)
            size = math.ceil(len(alike) / math.ceil(len(alike) / AT_ONCE))
            yield from (alike[k : k + size] for k in range(0, len(alike), size))

    def tie_to_neighbours(
        self, row: int, neighbours: Sequence[Motion], fps: float, body: BodyModel
    ) -> OverlapEnergy:
        """Return the energy that keeps a window near its finished neighbours in the overlap."""
        (start, stop), like = self.time_range(row), self.guess.translation
        frames = math.floor((stop - start) * fps + 1e-4) + 1
        times = start + torch.arange(frames, dtype=torch.float64, device=like.device) / fps
        joints, weight = like.new_zeros(frames, 22, 3), like.new_zeros(frames)
        for motion in neighbours:
            begins, ends = motion.start_time, motion.stop_time
            shared = (times > begins - 1e-6) & (times < ends + 1e-6)
            joints[shared] = body.pose(motion.at(times[shared], fps)).joints
            later = smooth_ramp(times[shared], max(start, begins), min(stop, ends)).to(weight)
            weight[shared] = later if begins > start else 1 - later
        return OverlapEnergy(joints, weight, fps)


def frames_to_common_time(fps: float) -> int:
    """Return after how many frames a clock and one at 30 Hz agree again; 1 if not in 0.2 s."""
    step = Fraction(fps / REFERENCE_FPS).limit_denominator(100).numerator
    others = step * REFERENCE_FPS / fps
    meets = abs(others - round(others)) < 1e-6
    return step if meets and 1 <= step <= _MAX_STEP_S * fps else 1
