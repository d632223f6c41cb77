"""Two uses of a motion prior that need nothing but the right points marked as not seen.

In-betweening: joints are seen but for one second in the middle. Upper body: joints from the pelvis
up are seen, no legs. The points that are seen have 1 cm of noise per coordinate.
"""

from collections.abc import Mapping

from benchmarks.scores import Columns, Fitted, Rows, fit_windows, score
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.protocols import UPPER_BODY, noisy_joints, with_gap
from recon.benchmark.windows import FPS, TrueWindows
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.method.reconstruction import Method

NOISE = 0.01
GAP = round(1.0 * FPS)
"""Frames."""

GAP_COLUMNS: Columns = {
    "joints_all": ("all", 100), "joints_legs": ("legs", 100), "root_joints_all": ("pose", 100),
    "accel_ratio": ("accel / true", 1), "accel_error": ("accel error", 1),
    "penetration_freq": ("pen. %", 100), "slip_speed": ("slip cm/s", 100),
    "seconds": ("CPU s", 1),
}  # fmt: skip
UPPER_COLUMNS: Columns = {
    "joints_legs": ("legs", 100),
    **{k: v for k, v in GAP_COLUMNS.items() if k != "joints_legs"},
}
"""`pose` is the error of all joints as seen from the pelvis."""


def recipe_methods(priors: Mapping[str, Humor]) -> dict[str, Method]:
    """Stages 1 and 2, and all steps under each prior, for the noise of the recipes."""
    methods: dict[str, Method] = {
        "stages 1-2": PosePrior.load(weights=PoseWeights.for_noise(NOISE))
    }
    return methods | {name: Collocation.for_noise(own, NOISE) for name, own in priors.items()}


def in_between_rows(
    windows: TrueWindows, body: BodyModel, priors: Mapping[str, Humor], seed: int
) -> dict[str, Rows]:
    """Metrics inside the gap."""
    start = (windows.truth.frames - GAP) // 2
    stop = start + GAP
    observed = with_gap(noisy_joints(windows.truth, body, seed, NOISE), slice(start, stop))
    inside = windows.frames(start, stop)
    found = {
        name: fit_windows(observed, method, body)
        for name, method in recipe_methods(priors).items()
    }
    straight = interpolated(found["stages 1-2"].motion, start, stop)
    rows = {"linear, slerp": score(inside, Fitted(straight), body)}
    rows |= {name: score(inside, own.frames(start, stop), body) for name, own in found.items()}
    return {**rows, "truth": score(inside, Fitted(inside.truth), body)}


def upper_body_rows(
    windows: TrueWindows, body: BodyModel, priors: Mapping[str, Humor], seed: int
) -> dict[str, Rows]:
    """Metrics of the whole body."""
    observed = noisy_joints(windows.truth, body, seed, NOISE, UPPER_BODY)
    rows = {
        name: score(windows, fit_windows(observed, method, body), body)
        for name, method in recipe_methods(priors).items()
    }
    return {**rows, "truth": score(windows, Fitted(windows.truth), body)}


def interpolated(motion: Motion, start: int, stop: int) -> Motion:
    """The frames of a gap between the last frame before and the first one after it.

    Translations linearly, rotations along the shortest arc.
    """
    ends = [start - 1, stop]
    pair = motion.replace(
        translation=motion.translation[:, ends],
        rotations=motion.rotations[:, ends],
        valid=motion.valid[:, ends],
        fps=motion.fps / (stop + 1 - start),
        start_time=motion.start_time + (start - 1) / motion.fps,
    )
    return pair.at(motion.times[start:stop], motion.fps)
