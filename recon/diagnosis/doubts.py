"""Other motions that explain the data of a fit, and which of its joints were seen."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, LEGS, MIRROR
from recon.fitting.records import ClipFit
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor
from recon.method.stages import ComparedHypotheses

_SAME_MOTION_M = 0.05
"""Mean distance of joints, metres, below which two hypotheses have come to the same motion."""
_TURNED = math.radians(45)
"""Turn about the vertical from which on a hypothesis is one of another heading."""
_LEGS, _EXCHANGED = list(LEGS), [MIRROR[k] for k in LEGS]


@dataclass(frozen=True)
class AlternativeMotion:
    """Another motion that explains the data, and by how much its energy is higher."""

    kind: str
    """What distinguishes it: "heading", "leg order" or "posture"."""
    turn: float
    """Degrees about the vertical, from 0 to 180, by which it faces elsewhere, on average."""
    distance: float
    """Mean distance of its joints from those of the motion that was chosen, metres."""
    energy: float
    """Its objective, at the end of the stage that compared it."""
    chosen_energy: float
    """The objective of the motion that was chosen, at the end of the same stage."""

    @property
    def excess(self) -> float:
        """By how much this motion's energy is larger, as a share of the chosen motion's."""
        if self.chosen_energy <= 0:  # happens with data without noise
            return math.inf
        return self.energy / self.chosen_energy - 1

    def report(self) -> dict[str, Any]:
        """The record as it stands in a report's list `alternatives`."""
        excess = self.excess if math.isfinite(self.excess) else None
        return {**asdict(self), "excess": excess, "message": str(self)}

    def __str__(self) -> str:
        """The alternative in words."""
        what = {
            "heading": f"facing {self.turn:.0f} degrees elsewhere",
            "leg order": "with left and right leg exchanged",
            "posture": "in another posture",
        }[self.kind]
        return (
            f"{what}, {100 * self.distance:.0f} cm away: energy {100 * self.excess:+.1f} % of "
            "that of the result"
        )


def alternatives(fit: ClipFit) -> tuple[AlternativeMotion, ...]:
    """Rejected hypotheses of the first clip, the likeliest first.

    They are other first guesses (headings, postures) and other beginnings of a gait cycle, each as
    the quick fit that compared them had left it. Hypotheses that came to the motion that was
    chosen, or to that of a likelier one, are left out.
    """
    body = fit.result.body.model
    found = [one for compared in fit.compared for one in _runners_up(compared, body)]
    return tuple(sorted(found, key=lambda one: one.excess))


def _runners_up(compared: ComparedHypotheses, body: BodyModel) -> list[AlternativeMotion]:
    """The hypotheses that one comparison rejected."""
    own = (compared.clip == 0).nonzero()[:, 0]
    finite = own[compared.value[own].isfinite()]
    kept = finite[compared.kept[finite]]
    if len(kept) == 0:
        return []
    best = int(kept[compared.value[kept].argmin()])
    given_up = finite[~compared.kept[finite]]
    ordered = given_up[compared.value[given_up].argsort()].tolist()
    with torch.no_grad():
        clips = [compared.motion[k] for k in (best, *ordered)]
        posed = [body.pose(one.window(0, int(one.valid.sum()))).joints for one in clips]
    (kept_joints, *others), found = posed, list[AlternativeMotion]()
    distinct = [kept_joints]
    for row, joints in zip(ordered, others, strict=True):
        if all(_mean_joint_distance(joints, other) > _SAME_MOTION_M for other in distinct):
            distinct.append(joints)
            turn = _heading_difference(compared.motion[best], compared.motion[row])
            sides = [
                _mean_joint_distance(joints[:, legs], kept_joints[:, _LEGS])
                for legs in (_EXCHANGED, _LEGS)
            ]
            kind = "leg order" if sides[0] < 0.5 * sides[1] else "posture"
            kind = "heading" if turn > _TURNED else kind
            energies = (float(compared.value[k]) for k in (row, best))
            found.append(
                AlternativeMotion(
                    kind, math.degrees(turn), _mean_joint_distance(kept_joints, joints), *energies
                )
            )
    return found


def _mean_joint_distance(
    one: Float[Tensor, "time some 3"], other: Float[Tensor, "time some 3"]
) -> float:
    """Mean distance of joints, metres."""
    return float((one - other).norm(dim=-1).mean())


def _heading_difference(one: Motion, other: Motion) -> float:
    """Angle about the vertical between the headings of two motions, averaged; 0 to pi."""
    between = so3.heading(one.rotations[:, 0]).mT @ so3.heading(other.rotations[:, 0])
    mean = between[one.valid].mean(0)
    return abs(math.atan2(float(mean[1, 0] - mean[0, 1]), float(mean[0, 0] + mean[1, 1])))


def observed_joints(
    observations: Sequence[Sensor], estimate: Estimate
) -> Bool[np.ndarray, "time 22"]:
    """The joints that some sensor saw, for every frame of the first clip's motion.

    A joint is seen where a visible point lies within 20 cm of it at rest and on a bone that ends
    or begins there; or where points of a cloud lie within 15 cm of it.
    """
    motion = estimate.motion
    times = motion.start_time + np.arange(motion.frames) / motion.fps
    seen = np.zeros((motion.frames, len(JOINTS)), dtype=bool)
    for observation in observations:
        moments = observation.shown_joints(estimate)
        # the observation's nearest frame in time, for every frame of the motion
        number = np.rint((times - observation.start_time) * observation.fps).astype(int)
        within = (number >= 0) & (number < len(moments))
        seen[within] |= moments[number[within]]
    return seen
