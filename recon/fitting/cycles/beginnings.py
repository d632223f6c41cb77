"""Cycles to begin from: typical ones in several headings, along the path that is seen.

A code knows what moves how, but neither which foot is in front nor where the body faces: energies
have minima for both. So typical codes are tried in several headings, all as one batch.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.together.kinds import InSpace
from recon.body.cycles import LONGEST_CYCLE, SHORTEST_CYCLE
from recon.core import rotations as so3
from recon.core.errors import ObservationError
from recon.core.scene import Scene
from recon.core.struct import concatenate
from recon.fitting.cycles.clock import completion_rate
from recon.method.priors import CyclePrior
from recon.method.running import Hypotheses
from recon.method.unknowns import Unknowns

HEADINGS = 8
"""Directions in which typical cycles are tried."""


@dataclass(frozen=True)
class CycleClock:
    """The moments at which cycles are decoded."""

    valid: Bool[Tensor, "clips time"]
    fps: float
    start_time: float

    @classmethod
    def of(cls, observations: Sequence[InSpace]) -> "CycleClock":
        """The first observation's rate or a multiple or part of it, over all that is seen.

        Raises:
            ObservationError: when a clip shows one moment only, or lasts too short or too long.
        """
        fps, start = completion_rate(observations[0].fps), min(o.start_time for o in observations)
        ends = [seen_from_to(o) for o in observations]
        first, last = (torch.stack(one) for one in zip(*ends, strict=True))
        if not bool((last.amax(0) > first.amin(0)).all()):
            raise ObservationError(
                "at most one moment shows anything, which tells no motion; give two or more"
            )
        last = last.amax(0) - start
        worst = last[((last < SHORTEST_CYCLE) | (last > LONGEST_CYCLE)).nonzero()[:1, 0]]
        if len(worst) > 0:
            raise ObservationError(
                f"a cycle of gait lasts {SHORTEST_CYCLE} to {LONGEST_CYCLE:g} s, what is seen "
                f"here {float(worst[0]):.2f} s; cut one cycle out (--between), or fit the whole "
                "with another prior"
            )
        count = (last * fps - 1e-6).ceil().long() + 1
        return cls(torch.arange(int(count.max())) < count[:, None], fps, start)


def seen_from_to(one: InSpace) -> tuple[Float[Tensor, " clips"], Float[Tensor, " clips"]]:
    """Times of the first and last moment of each clip that show anything; infinite where none."""
    there = one.shown.any(-1).cpu()
    times = one.start_time + torch.arange(there.shape[-1], dtype=torch.float64) / one.fps
    return times.where(there, torch.inf).amin(-1), times.where(there, -torch.inf).amax(-1)


def typical_cycles(
    prior: CyclePrior,
    observations: Sequence[InSpace],
    clock: CycleClock,
    shape: Float[Tensor, " shape"],
    offsets: int,
) -> Hypotheses[Any]:
    """Every typical cycle of a prior in every heading, along the path that is seen.

    Args:
        prior: of cycles.
        observations: of the clips.
        clock: the moments of the cycles.
        shape: of the body.
        offsets: number of tracked points whose offset from the model is unknown.
    """
    typical = prior.typical
    angles = torch.arange(HEADINGS) * (math.tau / HEADINGS)
    turns = so3.about_z(angles.to(typical))
    path = prior.paths(shape)
    variables: list[Any] = []
    for clip, (seen, there) in enumerate(zip(*_seen_path(observations, clock), strict=True)):
        last = int(clock.valid[clip].sum()) - 1
        place = torch.arange(len(seen)).clamp(max=last) / last * (path.shape[1] - 1)
        walked = path[:, place.round().long()]
        turned = walked[:, None] @ turns.mT
        away = (seen - turned).where(there[:, None], 0.0).sum(-2) / there.sum().clamp(min=1)
        T = torch.eye(4).to(typical).repeat(len(typical), HEADINGS, 1, 1)
        T[..., :3, :3], T[..., :2, 3] = turns, away[..., :2]
        count = T.shape[0] * T.shape[1]
        variables.append(
            prior.variables(
                typical.repeat_interleave(HEADINGS, 0),
                shape.expand(count, -1),
                T.flatten(0, 1),
                clock.valid[clip].expand(count, -1),
                clock.fps,
                clock.start_time,
            )
        )
    clip = torch.arange(len(variables)).repeat_interleave(len(variables[0].latent))
    scene = Scene.create(len(clip), offsets, like=typical)
    return Hypotheses(prior, Unknowns(concatenate(variables), scene), clip)


def _seen_path(
    observations: Sequence[InSpace], clock: CycleClock
) -> tuple[Float[Tensor, "clips moments 3"], Bool[Tensor, "clips moments"]]:
    """The middle of what is seen at the clock's moments, and where anything is."""
    clips, moments = clock.valid.shape
    total = observations[0].places.new_zeros(clips, moments, 3)
    count = total.new_zeros(clips, moments, 1)
    for one in observations:
        present = one.shown
        middle = one.places.where(present[..., None], torch.nan).nanmedian(-2).values
        there = present.any(-1)
        times = one.start_time - clock.start_time + torch.arange(there.shape[1]) / one.fps
        frame = (times * clock.fps).round().long().clamp(0, moments - 1)
        total.index_add_(1, frame, middle.nan_to_num(0.0))
        count.index_add_(1, frame, there[..., None].to(count))
    return total / count.clamp(min=1), count[..., 0] > 0
