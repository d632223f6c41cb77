"""Steps of motions that are made up: of several draws the one whose feet carry the body.

Small errors of steps add up when nothing is observed: bodies drift off the ground, or into it.
Physics, which no network has to learn, holds them: several next states are drawn of every motion,
one is kept by how well a foot of it rests on the ground (`recon.physics.support`), and what is
left of its distance to the ground is taken back a little at a time.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.humor.state import State
from recon.core.skeleton import FEET
from recon.method.protocols import REFERENCE_FPS
from recon.physics.support import carried_share, foot_energy

_SUNK = 0.01
"""Metres below its height at rest that a joint of a foot may be."""
_SUNK_SCALE = 0.02
"""Standard deviation of what is deeper, metres."""
_ABOVE = 0.02
"""Metres that the lower foot of a body that does not fly may be above the ground."""


@dataclass(frozen=True)
class Footing:
    """How much the ground has to say; chosen among a dozen settings on validation people."""

    draws: int = 8
    """Next states of each motion, of which one is kept."""
    strictness: float = 4.0
    """A draw is kept with probability ∝ exp(-strictness · nats)."""
    raised: float = 0.2
    """Share of the depth of a sunk foot by which the body is raised in every step."""
    lowered: float = 0.1
    """Share of the height of the lower foot by which a body that does not fly is lowered."""

    def kept(
        self,
        before: State,
        after: State,
        touching: Float[Tensor, "all 4"],
        random: torch.Generator,
    ) -> Int[Tensor, " clips"]:
        """Numbers of the draws that are kept, one of each run of `draws`.

        Args:
            before: states in the world, each repeated for its draws.
            after: the draws.
            touching: heights at which ankles and toes touch, metres.
            random: of the choice.
        """
        height = after.joints[:, FEET, 2] - touching
        speed = (after.joints - before.joints)[:, FEET].square().sum(-1) * REFERENCE_FPS**2
        rests = foot_energy(height, speed).amin(-1)
        sunk = (-height - _SUNK).amax(-1).clamp(min=0) / _SUNK_SCALE
        nats = _share(before, after) * rests + 0.5 * sunk.square()
        likely = (-self.strictness * nats).unflatten(0, (-1, self.draws)).softmax(-1)
        chosen = torch.multinomial(likely.cpu(), 1, generator=random)[:, 0].to(touching.device)
        return chosen + self.draws * torch.arange(len(chosen), device=chosen.device)

    def grounded(self, before: State, after: State, touching: Float[Tensor, "clips 4"]) -> State:
        """The states, nearer to the ground; arguments as of `kept`, without draws."""
        lower = (after.joints[:, FEET, 2] - touching).amin(-1)
        raised = self.raised * (-lower - _SUNK).clamp(min=0)
        lowered = self.lowered * _share(before, after) * (lower - _ABOVE).clamp(min=0)
        up = after.translation.new_tensor([0.0, 0.0, 1.0])
        shift = (raised - lowered)[:, None] * up
        return after.replace(
            translation=after.translation + shift, joints=after.joints + shift[:, None]
        )


def _share(before: State, after: State) -> Float[Tensor, " all"]:
    """Share of its weight that the ground carries of a body, from one state to the next."""
    rise = (after.joints - before.joints)[:, 0, 2] * REFERENCE_FPS
    return carried_share((rise - before.velocity[:, 2]) * REFERENCE_FPS)
