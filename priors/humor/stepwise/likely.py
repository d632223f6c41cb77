"""Likely states: what HuMoR's networks cannot say of limbs that nobody saw.

A conditional prior tells how likely a step is from the state before it, not how likely that state
is. Legs that take too few steps for the arms' swing get from one unlikely state to the next by
likely steps, and fewer nats per second than true ones. The mixture of initial states is a density
of all states of the training corpus, with their velocities, and knows better.
"""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from priors.humor.prior import Humor
from priors.humor.state import canonical, initial_features, posed_states
from priors.humor.stepwise.energies import RARITY, heavy_tailed
from priors.humor.stepwise.tempo import as_read
from recon.core.struct import TensorStruct
from recon.method.protocols import Estimate


@dataclass(frozen=True, eq=False)
class LikelyStates(TensorStruct):
    """Energy of the states of clips in which nobody saw some limb, at 30 Hz."""

    humor: Humor
    """Prior whose mixture of initial states is the density."""
    unseen: Bool[Tensor, "clips 22"]
    """Joints that nobody saw (`priors.humor.stepwise.limbs`); clips without any have no energy."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, " clips"]:
        """Σ_t ρ(r(x_t)) over the states x_t in their own canonical frames; nats.

        r is the mixture's `rarity` and ρ(x) = s log(1 + x / s) has heavy tails: strangers may
        do what nobody of the corpus did.
        """
        motion = estimate.motion
        humor = self.humor.like(motion.translation)
        states = posed_states(as_read(motion), estimate.body.joints)
        states = canonical(states, humor.pelvis(motion.shape)[:, None])
        rarity = humor.initial.rarity(initial_features(states))
        exists = motion.valid & self.unseen.any(-1)[:, None]
        return heavy_tailed(rarity, RARITY).where(exists, 0.0).sum(-1)
