"""`recon.interpolate`: a gait cycle interpolated from two motions, without sliding feet."""

from dataclasses import asdict

import torch
from jaxtyping import Float
from torch import Tensor

from priors.anchor.frames import ANCHORS
from priors.anchor.prior import AnchorFrames
from recon.api.given import BodyLike, GivenMotion, MotionLike, body_given, motion_given
from recon.api.made import MadeMotion
from recon.api.result import motion_file_of
from recon.body.cycles import LONGEST_CYCLE, SHORTEST_CYCLE, Cycle
from recon.body.model import BodyModel
from recon.core.arrays import finite_number, usable_frame_rate
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.fitting.interpolation import (
    curve_correlation,
    cycles_of,
    foot_above_other,
    interpolated_cycle,
    motion_of_cycle,
)
from recon.fitting.retargeting import airborne_frames, corrected_on_ground


def interpolate(
    a: MotionLike,
    b: MotionLike,
    at: float = 0.5,
    *,
    weights: str = "open",
    body: BodyLike = None,
    fps: float | None = None,
) -> MadeMotion:
    """Make a gait cycle by interpolating between the gait cycles of two motions.

    Of each the best cycle is taken. Best are those that look like gait and stand on the same feet:
    backward walking, whose hips swing as those of forward walking do, stands on the other foot
    meanwhile. The anchor-frame prior mixes their codes and bodies. The result begins between where
    they begin, facing between them. Nothing is random, and everything is computed on the
    processor.

    The report (`about`) has the two `cycles` (seconds), their `durations` and that of the result
    (seconds), and by how much their feet agree, -1 to 1.

    Args:
        a: a motion of one clip that walks or runs.
        b: another.
        at: share of the second, 0 to 1.
        weights: of the prior: `open` or a file.
        body: both motions' body; a SMPL-family file; default: the bundled body.
        fps: rate of the result, frames per second; default: the first motion's.

    Raises:
        ReconError: for a share outside 0 to 1, a motion that is damaged, of another body or
            without a cycle, and for motions whose cycles never stand on the same feet.
        FileNotFoundError: when there is no such file.
    """
    share = finite_number(at, "at")
    if not 0 <= share <= 1:
        raise ReconError(
            f"at: expected a number from 0 (the first motion) to 1 (the second), got {at}"
        )
    rate = None if fps is None else usable_frame_rate(fps, "fps")
    model = body_given(body)
    prior = AnchorFrames.load(weights, model)
    given = (motion_given(a, model, "a"), motion_given(b, model, "b"))
    candidates = [_gait_cycles(one) for one in given]
    lifts = [_foot_lifts(model, one.motion, x) for one, x in zip(given, candidates, strict=True)]
    agree = curve_correlation(*lifts)
    if float(agree.max()) <= 0:
        raise ReconError(
            f"{given[0].name} and {given[1].name}: where one stands on the left foot the other "
            "stands on the right, so a motion between them would stand on neither; give a longer "
            "recording of one, or a cycle that begins half a cycle later"
        )
    costs = [torch.tensor([cycle.cost for cycle in found]) for found in candidates]
    unlike = costs[0][:, None] + costs[1] - agree
    first, second = divmod(int(unlike.argmin()), unlike.shape[1])
    chosen = (candidates[0][first], candidates[1][second])
    parts = [
        prior.encode(cycle.of(one.motion, ANCHORS)[None])
        for cycle, one in zip(chosen, given, strict=True)
    ]
    mixed = interpolated_cycle(prior, parts[0], parts[1], share)
    made = motion_of_cycle(prior, mixed, given[0].motion.fps if rate is None else rate)
    motion = corrected_on_ground(made, made, airborne_frames(made, model), model).detach()
    durations = {
        "A": chosen[0].duration,
        "B": chosen[1].duration,
        "result": float(prior.anchors(mixed).duration[0]),
    }
    about = {
        "feet agree": float(agree[first, second]),
        "cycles": {
            name: {"file": one.name, **asdict(cycle)}
            for name, one, cycle in zip("AB", given, chosen, strict=True)
        },
        "durations": durations,
    }
    lines = [f"cycle of {name}: {seconds:.2f} s" for name, seconds in durations.items()]
    tables = {f"{share:g} of the way": {"seconds": durations}}
    return MadeMotion(
        motion_file_of(motion[0], model), model, (), about, tuple(lines), summary_tables=tables
    )


def _gait_cycles(given: GivenMotion) -> tuple[Cycle, ...]:
    found = cycles_of(given.motion)
    if len(found) == 0:
        raise ReconError(
            f"{given.name}: found no cycle of gait, in which both hips swing once and come back "
            f"within {SHORTEST_CYCLE} to {LONGEST_CYCLE:g} s; give a motion that walks or runs, "
            "or cut one cycle out"
        )
    return found


def _foot_lifts(
    body: BodyModel, motion: Motion, cycles: tuple[Cycle, ...]
) -> Float[Tensor, "cycles 100"]:
    return torch.stack(
        [foot_above_other(body.pose(cycle.of(motion, ANCHORS)).joints) for cycle in cycles]
    )
