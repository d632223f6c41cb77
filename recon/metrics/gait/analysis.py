"""Everything about the gait of one clip: events, cycles, figures and joint angles."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.angles.isb import ISB_ANGLES, isb_angles
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.metrics.gait.curves import CURVES, GaitCurve, flexion_std, over_cycle
from recon.metrics.gait.cycles import PERCENT, GaitCycle, find_gait_cycles, normalised
from recon.metrics.gait.events import GaitStance, Side, find_stances
from recon.metrics.gait.feet import SIDES, Feet
from recon.metrics.gait.figures import GaitFigure, spatio_temporal


@dataclass(frozen=True)
class Gait:
    """The gait of one clip."""

    times: Float[np.ndarray, " time"]
    """Seconds of the recording's clock."""
    stances: tuple[GaitStance, ...]
    """Stances of both feet in the order of time."""
    cycles: tuple[GaitCycle, ...]
    """Complete strides of both feet in the order of their strikes."""
    figures: tuple[GaitFigure, ...]
    """Spatio-temporal figures: cadence, lengths, speed, shares of the cycle."""
    angles: Mapping[str, Float[np.ndarray, " time"]]
    """Joint angles after the ISB, degrees, as `recon.body.angles.isb.isb_angles` names them."""
    angle_std: Mapping[str, Float[np.ndarray, " time"]]
    """Standard deviations of some of the angles, degrees; empty where those of joints are not
    known."""
    unseen: Mapping[str, float]
    """Share of the frames in which an angle was inferred rather than seen, where there are any."""
    belt: float | None
    """Speed of the treadmill's belt, m/s; None where the ground rests."""

    def cycles_of(self, side: Side) -> tuple[GaitCycle, ...]:
        """The cycles that begin with the strike of one foot."""
        return tuple(cycle for cycle in self.cycles if cycle.side == side)

    def curves(self, curve: GaitCurve, side: Side) -> Float[np.ndarray, "cycles percent"]:
        """An angle over all cycles of a side, degrees."""
        found = [
            over_cycle(curve, self.angles, self.times, cycle) for cycle in self.cycles_of(side)
        ]
        return np.array(found).reshape(len(found), PERCENT)

    def curve_std(
        self, curve: GaitCurve, side: Side
    ) -> Float[np.ndarray, "cycles percent"] | None:
        """Standard deviation with which a curve is known, degrees; None where it is not."""
        known = self.angle_std.get(curve.angle(side))
        if known is None or len(self.cycles_of(side)) == 0:
            return None
        return np.array([normalised(known, self.times, one) for one in self.cycles_of(side)])


def analyse(
    motion: Motion,
    body: BodyModel,
    *,
    ground: float | None = 0.0,
    belt: Float[Tensor, " 2"] | None = None,
    joint_std: Float[Tensor, "time 22"] | None = None,
    angle_std: Float[Tensor, "time 42"] | None = None,
    observed: Bool[Tensor, "time 22"] | None = None,
) -> Gait:
    """Events, cycles, figures and angles of one clip.

    Args:
        motion: one clip without a batch axis, z up.
        body: whose motion it is; the bundled one, whose landmarks are known.
        ground: height of the ground, metres; None where there is none.
        belt: velocity of a treadmill's belt, m/s; None where the ground rests.
        joint_std: standard deviation of a coordinate of every joint, metres; None where unknown.
        angle_std: standard deviations of the ISB's angles, degrees; without them, those of
            flexions follow from `joint_std`.
        observed: false where a joint was inferred; None means that all were seen.

    Raises:
        ReconError: when the body is another one.
    """
    feet = Feet.of(motion, body, ground, belt)
    stances = find_stances(feet)
    cycles = find_gait_cycles(feet, stances)
    joints = body.pose(motion.detach()).joints.double().cpu().numpy()
    std = None if joint_std is None else joint_std.double().cpu().numpy()
    return Gait(
        times=feet.times,
        stances=stances,
        cycles=cycles,
        figures=spatio_temporal(cycles),
        angles=isb_angles(motion, body),
        angle_std=_angle_std(angle_std, joints, std),
        unseen={} if observed is None else _unseen(observed),
        belt=None if belt is None else float(belt.norm()),
    )


def _angle_std(
    known: Float[Tensor, "time 42"] | None,
    joints: Float[np.ndarray, "time 22 3"],
    std: Float[np.ndarray, "time 22"] | None,
) -> dict[str, Float[np.ndarray, " time"]]:
    if known is not None:
        return dict(zip(ISB_ANGLES, known.double().cpu().numpy().T, strict=True))
    return {} if std is None else flexion_std(joints, std)


def _unseen(observed: Bool[Tensor, "time 22"]) -> dict[str, float]:
    seen = observed.cpu().numpy()
    shares: dict[str, float] = {}
    for curve in CURVES:
        for name in SIDES:
            side: Side = "left" if name == "left" else "right"
            share = float(1 - seen[:, curve.seen_joints(side)].all(-1).mean())
            angle = curve.angle(side)
            shares[angle] = max(share, shares.get(angle, 0.0))
    return {name: share for name, share in shares.items() if share > 0}
