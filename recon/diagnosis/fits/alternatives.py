"""Runners-up: other motions that a fit compared with the one it gives, and their energies."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import LEGS, MIRROR
from recon.fitting.clip import ClipFit
from recon.method.stages import Compared

_SAME = 0.05
"""Mean distance of joints, metres, below which two hypotheses have come to the same motion."""
_TURNED = math.radians(45)
"""Turn about the vertical from which on a hypothesis is one of another heading."""
_LEGS, _EXCHANGED = list(LEGS), [MIRROR[k] for k in LEGS]


@dataclass(frozen=True)
class Alternative:
    """Another motion that explains the data, and how much worse it does."""

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
        """Share of the chosen energy by which this one is larger."""
        if self.chosen_energy <= 0:  # data without noise
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


def alternatives(fit: ClipFit) -> tuple[Alternative, ...]:
    """Motions of the first clip that its fit compared and gave up, the likeliest first.

    They are other first guesses (headings, postures) and other beginnings of a gait cycle, each as
    the quick fit that compared them had left it. Hypotheses that came to the motion that was
    chosen, or to that of a likelier one, are left out.
    """
    body = fit.result.body.model.to(device="cpu")
    found = [one for compared in fit.compared for one in _of(compared, body)]
    return tuple(sorted(found, key=lambda one: one.excess))


def _of(compared: Compared, body: BodyModel) -> list[Alternative]:
    """The runners-up of one comparison."""
    own = (compared.clip == 0).nonzero()[:, 0]
    finite = own[compared.value[own].isfinite()]
    kept = finite[compared.kept[finite]]
    if len(kept) == 0:
        return []
    best = int(kept[compared.value[kept].argmin()])
    given_up = finite[~compared.kept[finite]]
    ordered = given_up[compared.value[given_up].argsort()].tolist()
    joints = {k: _joints(compared.motion, k, body) for k in (best, *ordered)}
    distinct, found = [joints[best]], list[Alternative]()
    for row in ordered:
        if all(_apart(joints[row], other) > _SAME for other in distinct):
            distinct.append(joints[row])
            found.append(_alternative(compared, best, row, joints[best], joints[row]))
    return found


def _alternative(
    compared: Compared,
    best: int,
    row: int,
    chosen: Float[Tensor, "time 22 3"],
    other: Float[Tensor, "time 22 3"],
) -> Alternative:
    turn = _turn(compared.motion[best], compared.motion[row])
    kind = "posture"
    if turn > _TURNED:
        kind = "heading"
    elif _apart(other[:, _EXCHANGED], chosen[:, _LEGS]) < 0.5 * _apart(
        other[:, _LEGS], chosen[:, _LEGS]
    ):
        kind = "leg order"
    return Alternative(
        kind,
        math.degrees(turn),
        _apart(chosen, other),
        float(compared.value[row]),
        float(compared.value[best]),
    )


def _joints(motion: Motion, row: int, body: BodyModel) -> Float[Tensor, "time 22 3"]:
    one = motion[row]
    with torch.no_grad():
        return body.pose(one.window(0, int(one.valid.sum()))).joints


def _apart(one: Float[Tensor, "time some 3"], other: Float[Tensor, "time some 3"]) -> float:
    """Mean distance of joints, metres."""
    return float((one - other).norm(dim=-1).mean())


def _turn(one: Motion, other: Motion) -> float:
    """Angle about the vertical between the headings of two motions, averaged; 0 to pi."""
    between = so3.heading(one.rotations[:, 0]).mT @ so3.heading(other.rotations[:, 0])
    mean = between[one.valid].mean(0)
    return abs(math.atan2(float(mean[1, 0] - mean[0, 1]), float(mean[0, 0] + mean[1, 1])))
