"""Weights of the energies of steps, and how much a step counts that is far from the corpus."""

from dataclasses import dataclass

import torch
from torch import Tensor

from priors.pose.prior import PoseWeights

ERROR, SURPRISE = 100.0, 20.0
"""Energies of one step, in nats, beyond which it counts less and less. A step that is far from
the corpus is one that the networks never saw, so the data should decide about it."""
RARITY = 300.0
"""Rarity of one state (`priors.humor.stepwise.likely`), in nats, beyond which it counts less and
less. Draws of the mixture of initial states have 66 on average."""


@dataclass(frozen=True)
class CollocationWeights:
    """Multipliers of the unweighted energies, for an observation of weight one."""

    pose: PoseWeights
    """Weights of the pose density, of the shape and of the remaining smoothness."""
    step: float
    """Weight of the squared error of the decoder, in nats per step."""
    latents: float
    """Weight of the KL divergence of the posterior from the prior, in nats per step."""
    contact_velocity: float
    """Weight of ½ c |step|² in metres², where c is the probability of contact of a joint."""
    support: float
    """Weight of feet that carry the body where nobody saw them, in nats per frame
    (`recon.physics.support`)."""
    state: float
    """Weight of the rarity of a state where nobody saw a limb, in nats per frame
    (`priors.humor.stepwise.likely`)."""

    @classmethod
    def for_noise(cls, noise: float) -> "CollocationWeights":
        """Weights for observations of a standard deviation of `noise` metres per coordinate.

        Chosen on validation subjects (abaa3a0: benchmarks/tune_humor.py). A calibrated bound
        would have multipliers of noise² for both of its parts; errors of neighbouring steps
        repeat each other, so less is better. Where points are exact, 14 mm remain, and 18.5 mm
        for steps: nobody moves just like the people of the corpus. The steps tell how smooth a
        motion is; a twenty-fifth of the pose prior's smoothness is left, which would make
        accelerations small.
        """
        pose = PoseWeights.for_noise(noise)
        variance = max(noise, 0.014) ** 2
        return cls(
            pose=PoseWeights(0.5 * pose.pose, pose.shape, acceleration=0.04 * pose.acceleration),
            step=0.125 * max(noise, 0.0185) ** 2,
            latents=0.3 * variance,
            contact_velocity=2e4 * max(noise, 0.008) ** 2,
            support=0.6 * variance,
            state=0.1 * variance,
        )


def heavy_tailed(nats: Tensor, scale: float) -> Tensor:
    """The energy ρ(x) = s log(1 + x / s): as x where it is small, slower where it is large."""
    return scale * torch.log1p(nats / scale)
