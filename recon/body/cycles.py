"""Find gait cycles in a motion by dynamic time warping of hip flexion onto two templates."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from recon.core.motion import Motion
from recon.core.skeleton import joint_index

RATE = 50
"""Frames per second at which hips are compared; a template lasts one second, and warping by 3
either way finds cycles of 0.33 to 3 s."""
SHORTEST_CYCLE, LONGEST_CYCLE = 0.3, 3.0
"""Seconds (Marsot et al., section 4)."""
THRESHOLD = 0.5
"""Largest mean squared difference from a template, in units of the hips' own variance; unrelated
hips have 2."""

_GAIT = (30.0, 26.0, 17.0, 7.0, -3.0, -10.0, -4.0, 14.0, 28.0, 33.0)
"""Flexion of the hip in degrees at every tenth of a cycle of walking, from the strike of its own
heel on, as textbooks draw it."""
_PATH_STEPS = ((1, 1), (1, 2), (1, 3), (2, 1), (3, 1))
"""Frames of template and recording that a path may advance by: slopes of 1/3 to 3."""
_NORMALISED_OVER_S = 1.5
"""Seconds over which the hips' mean and variance are taken."""
_LEAST_SWING = math.radians(5)
"""Standard deviation of hips that hardly move: they are compared as if they moved this much."""
_RETURN = math.radians(10)
"""Radians from its value at the start within which the flexion of either hip must come back at the
end."""
_OVERLAP = 0.5
"""Cycles with a larger intersection over union are the same one; the better is kept."""


@dataclass(frozen=True)
class Cycle:
    """One gait cycle: start and end time, the foot that strikes first, and the matching cost."""

    start: float
    """Seconds of the motion's clock."""
    stop: float
    side: str
    """The foot whose strike begins it, `left` or `right`."""
    cost: float
    """Mean squared difference from the template."""

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.stop - self.start

    def of(self, motion: Motion, frames: int) -> Motion:
        """Return the motion during this cycle, resampled to `frames` evenly spaced frames."""
        times = torch.linspace(self.start, self.stop, frames, dtype=torch.float64)
        return motion.at(times, (frames - 1) / self.duration)


def find_cycles(motion: Motion, threshold: float = THRESHOLD) -> tuple[Cycle, ...]:
    """All cycles of one clip (no batch axis), in the order of their starts.

    Subsequence dynamic time warping with slopes of 1/3 to 3: every template may begin and end
    anywhere. The flexions of both hips are compared, less their mean and over their deviation
    nearby, so that running and strolling both look like the template. Ends are the local minima
    of the path's cost; of overlapping cycles the best is kept. Marsot et al., section 4, with
    what it leaves open.
    """
    times = _frame_times(motion)
    if len(times) < SHORTEST_CYCLE * RATE:
        return ()
    flexion = hip_flexion(motion.at(torch.from_numpy(times), float(RATE)))
    hips = _standardised_flexion(flexion)
    found: list[Cycle] = []
    for side, template in _hip_flexion_templates().items():
        cost, first = warping_costs(template, hips)
        for last in _minima_below(cost, threshold):
            begin, end = times[first[last]], times[last]
            returns = np.abs(flexion[last] - flexion[first[last]]).max() <= _RETURN
            if SHORTEST_CYCLE <= end - begin <= LONGEST_CYCLE and returns:
                found.append(Cycle(float(begin), float(end), side, float(cost[last])))
    return _without_overlaps(found)


def hip_flexion(motion: Motion) -> Float[np.ndarray, "frames 2"]:
    """Flexion of the hips: how far each thigh is lifted forward, left and right, radians."""
    hips = [joint_index("left_hip"), joint_index("right_hip")]
    down = -motion.rotations[..., hips, :, 1].double().numpy()
    return np.arctan2(down[..., 2], -down[..., 1])


def warping_costs(
    template: Float[np.ndarray, "rows hips"], flexion: Float[np.ndarray, "frames hips"]
) -> tuple[Float[np.ndarray, " frames"], Int[np.ndarray, " frames"]]:
    """Return, per frame, the mean cost of the best warping path that ends there, and its start.

    Every row of the template counts once, so costs of paths of all lengths are comparable.
    """
    rows, frames = len(template), len(flexion)
    local = np.square(template[:, None] - flexion[None]).mean(-1)
    total = np.full((rows, frames), np.inf)
    begin = np.zeros((rows, frames), np.int64)
    total[0], begin[0] = local[0], np.arange(frames)
    for row in range(1, rows):
        for down, along in _PATH_STEPS:
            if down > row or along >= frames:
                continue
            counted = local[row - down + 1 : row + 1, along:].sum(0)
            through = total[row - down, : frames - along] + counted
            better = through < total[row, along:]
            total[row, along:][better] = through[better]
            begin[row, along:][better] = begin[row - down, : frames - along][better]
    return total[-1] / rows, begin[-1]


def _frame_times(motion: Motion) -> Float[np.ndarray, " frames"]:
    last = (int(motion.valid.sum()) - 1) / motion.fps
    return motion.start_time + np.arange(int(last * RATE + 1e-6) + 1) / RATE


def _hip_flexion_templates() -> dict[str, Float[np.ndarray, "rows 2"]]:
    """Return hip flexion (radians) in one gait cycle of 1 s, by the foot that strikes first."""
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(np.linspace(0, 1, 11), np.radians([*_GAIT, _GAIT[0]]), bc_type="periodic")
    phase = np.linspace(0, 1, RATE + 1)
    own, other = curve(phase), curve((phase + 0.5) % 1)
    own, other = (x - x[:-1].mean() for x in (own, other))
    scale = own[:-1].std()
    return {
        "left": np.stack([own, other], -1) / scale,
        "right": np.stack([other, own], -1) / scale,
    }


def _standardised_flexion(flexion: Float[np.ndarray, "frames 2"]) -> Float[np.ndarray, "frames 2"]:
    from scipy.ndimage import uniform_filter1d

    width = max(1, round(_NORMALISED_OVER_S * RATE))
    mean = uniform_filter1d(flexion, width, axis=0)
    away = flexion - mean
    variance = uniform_filter1d(np.square(away).mean(1), width)
    return away / np.maximum(np.sqrt(variance), _LEAST_SWING)[:, None]


def _minima_below(cost: Float[np.ndarray, " frames"], threshold: float) -> list[int]:
    """Frames that are local minima of the cost below the threshold."""
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    lowest: Bool[np.ndarray, " frames"] = (cost < padded[:-2]) & (cost <= padded[2:])
    return np.flatnonzero(lowest & (cost <= threshold)).tolist()


def _without_overlaps(cycles: list[Cycle]) -> tuple[Cycle, ...]:
    """Remove overlapping gait cycles, keeping those of least cost, in order of time."""
    kept: list[Cycle] = []
    for cycle in sorted(cycles, key=lambda cycle: cycle.cost):
        if all(_overlap_of_cycles(cycle, other) <= _OVERLAP for other in kept):
            kept.append(cycle)
    return tuple(sorted(kept, key=lambda cycle: cycle.start))


def _overlap_of_cycles(a: Cycle, b: Cycle) -> float:
    shared = min(a.stop, b.stop) - max(a.start, b.start)
    return max(shared, 0.0) / (max(a.stop, b.stop) - min(a.start, b.start))
