"""How windows are varied in training: the settings, and all edits in their order."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from training.humor.arms import may_move, moved
from training.humor.flights import flown, may_fly
from training.humor.legs import bent, may_bend, may_raise, may_step, raised, stepped
from training.humor.moments import Moments, with_edited


@dataclass(frozen=True)
class Variation:
    """Random variations of windows in training; zeros leave them as recorded."""

    mirror: float = 0.5
    """Chance of being mirrored."""
    reverse: float = 0.2
    """Chance of being played backwards: few people were recorded walking so."""
    speed: float = 0.15
    """Played up to this fraction faster or slower."""
    shape: float = 0.5
    """Standard deviation by which each shape coefficient is moved."""
    halves: float = 0.0
    """Chance of getting the trunk and arms of another clip."""
    raises: float = 0.0
    """Chance of a raised leg, where the other foot stands. A window in which a body could not move
    so stays as it was; and raises, sidesteps, bends and flights are tried in this order until one
    is made."""
    sidesteps: float = 0.0
    """Chance of a step aside, where both feet stand."""
    bends: float = 0.0
    """Chance of a pelvis that is lowered, turned and tilted over feet that stay where they are."""
    flights: float = 0.0
    """Chance of being in the air along a parabola."""
    arms: float = 0.0
    """Chance of arms that move otherwise."""
    kinds: float = 0.0
    """How far kinds of motion are balanced: 0 draws a kind as often as its clips say, 1 draws all
    kinds equally often."""
    people: float = 0.0
    """How far people are balanced, likewise."""


VARIED = Variation(
    speed=0.2,
    shape=1.0,
    halves=0.3,
    raises=0.6,
    sidesteps=0.4,
    bends=0.2,
    flights=0.05,
    arms=0.2,
    kinds=0.5,
    people=0.3,
)
"""The default variation of a training. Most windows differ from what was recorded, because the
corpus shows few people and few motions."""


def edited(moments: Moments, variation: Variation, random: torch.Generator) -> Moments:
    """Windows with the edits of legs and arms that their chances give them."""
    legs = (
        (may_raise, raised, variation.raises),
        (may_step, stepped, variation.sidesteps),
        (may_bend, bent, variation.bends),
        (may_fly, flown, variation.flights),
    )
    for group in (legs, ((may_move, moved, variation.arms),)):
        free = torch.ones_like(moments.rest[:, 0, 0], dtype=torch.bool)
        for may, edit, chance in group:
            if chance == 0:
                continue
            drawn = torch.rand(len(free), generator=random).to(moments.rest)
            rows = chosen_rows((drawn < chance) & free & may(moments))
            if len(rows) > 0:
                made, accepted = edit(moments[rows], random)
                moments = with_edited(moments, rows, made, accepted)
                free = free.index_put((rows,), ~accepted)
    return moments


def chosen_rows(chosen: Bool[Tensor, " windows"]) -> Int[Tensor, " some"]:
    """Numbers of the windows that are chosen."""
    return chosen.nonzero()[:, 0]
