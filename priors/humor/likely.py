"""A density of single states for unobserved limbs, which step networks hardly constrain.

A conditional prior tells how likely a step is from the state before it, not how likely that state
is. Legs that take too few steps for the arms' swing get from one unlikely state to the next by
likely steps, and fewer nats per second than true ones. The mixture of initial states is a density
of all states of the training corpus, with their velocities, and knows better.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humor.prior import Humor
from priors.humor.state import canonical_state, initial_features, posed_states, relabelled_at_30_hz
from priors.humor.steps import RARITY, heavy_tailed
from recon.core.struct import TensorStruct
from recon.method.protocols import Estimate
from recon.method.terms import Term

FASTEST = 3.6
"""Speed in m/s up to which people are read as they move: that of the fastest run that the bundled
weights learned from."""
_SPEED_SPAN_S = 0.5
"""Seconds between the two moments that tell a speed, in longer clips: noise of positions hardly
matters."""


def slowing_factor(data: Sequence[Term]) -> float:
    """Factor, at most 1, by which fast motions are slowed down for the networks.

    √(v₀ / v) for a mean speed v above v₀ = `FASTEST`: who runs faster takes longer steps and more
    of them, both about as the root of the speed. v is that of the slowest clip, by the sensor
    that tells most of it; clips of which no sensor tells a speed are read as they are.
    """
    speeds = [
        _centroid_speed(term.energy) for term in data if getattr(term.energy, "placed", False)
    ]
    if len(speeds) == 0:
        return 1.0
    slowest = float(torch.stack(speeds).amax(0).min())
    return math.sqrt(FASTEST / max(slowest, FASTEST))


def _centroid_speed(sensor: Any) -> Float[Tensor, " clips"]:
    """Mean speed of the centroid of visible points over `_SPEED_SPAN_S`, m/s."""
    places, shown = sensor.places, sensor.shown
    lag = max(1, min(round(_SPEED_SPAN_S * sensor.fps), places.shape[1] - 1))
    shown_twice = (shown[:, lag:] & shown[:, :-lag])[..., None].to(places)
    moved = (places[:, lag:] - places[:, :-lag]).where(shown_twice > 0, 0.0)
    middle = moved.sum(2) / shown_twice.sum(2).clamp(min=1)
    any_shown = shown_twice.any(2)[..., 0].to(places)
    far = (middle.norm(dim=-1) * any_shown).sum(1) / any_shown.sum(1).clamp(min=1)
    return far * sensor.fps / lag


@dataclass(frozen=True, eq=False)
class LikelyStates(TensorStruct):
    """Energy of how unlikely each state is, in clips in which a limb was never observed."""

    humor: Humor
    """Prior whose mixture of initial states is the density."""
    unseen: Bool[Tensor, "clips 22"]
    """Joints that nobody saw (`priors.look.looking.UnseenLimbs.never`); clips without any have no
    energy."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, " clips"]:
        """Σ_t ρ(r_t), nats: robust kernel ρ of the rarity r_t of states in their canonical frames.

        r_t is the mixture's `rarity` and ρ(x) = s log(1 + x / s) has heavy tails: strangers may
        do what nobody of the corpus did.
        """
        motion = estimate.motion
        humor = self.humor.like(motion.translation)
        states = posed_states(relabelled_at_30_hz(motion), estimate.body.joints)
        states = canonical_state(states, humor.pelvis(motion.shape)[:, None])
        rarity = humor.initial.rarity(initial_features(states))
        exists = motion.valid & self.unseen.any(-1)[:, None]
        return heavy_tailed(rarity, RARITY).where(exists, 0.0).sum(-1)

    def add_curvature(
        self, weight: float, estimate: Estimate, clip: int, joints: Float[Tensor, "time 3 66"]
    ) -> None:
        """Add nothing.

        The steps are stiffer, and L-BFGS infers the small curvature of this energy.
        """
