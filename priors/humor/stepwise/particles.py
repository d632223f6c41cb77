"""A particle filter over HuMoR's steps gives hypotheses of how limbs moved that nobody saw.

A fit that begins with limbs that hang still ends with limbs that hardly move: legs then float, and
swing by a fraction of what they should. Its objective is lower for legs that walk, but no small
step leads there. A particle filter looks further. Each particle is a state whose seen part is that
of a motion already fitted, and whose unseen limbs are its own. In every step a latent is drawn
from the conditional prior; the decoder tells the next state; the particle gains weight where that
agrees with what was seen, as legs that walk move the pelvis as it moved; and the seen part is put
in its place. Particles are drawn anew by their weights when few of them have most of it (the
bootstrap filter of Gordon, Salmond and Smith, 1993). Several filters that know nothing of each
other give several hypotheses.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.humor.prior import Humor
from priors.humor.state import State, states_of
from priors.humor.stepwise.drawn import drawn_step
from priors.humor.stepwise.limbs import LimbDraws
from priors.humor.stepwise.tempo import as_read
from recon.core.motion import Motion
from recon.core.skeleton import TOES
from recon.method.protocols import Estimate

_SOLE = 0.02
"""Height of a toe joint above the ground when the foot stands, metres."""
_SEED = 0


@dataclass(frozen=True)
class ParticleFilter:
    """Settings of the filter: first guesses, whose neighbours were no better (docs/humor.md)."""

    hypotheses: int = 4
    """Filters, each of which gives one motion."""
    particles: int = 128
    """States in each."""
    place: float = 0.015
    """Standard deviation of the seen joints about their prediction, on average, metres."""
    speed: float = 0.15
    """Standard deviation of their velocities, m/s."""
    depth: float = 0.03
    """Standard deviation of a foot below the ground, metres."""
    least: float = 0.5
    """Particles are drawn anew when the effective ones are a smaller share than this."""

    @torch.no_grad()
    def __call__(
        self, humor: Humor, motion: Motion, unseen: Bool[Tensor, " 22"]
    ) -> Float[Tensor, "hypotheses time 21 3 3"]:
        """Rotations of the body joints; those that were seen are the motion's.

        Args:
            humor: the prior, of the motion's precision.
            motion: of one clip in the world, on the ground z = 0, whose frames are steps of the
                networks; axes (1, time).
            unseen: joints whose rotations are to be found.
        """
        random = torch.Generator().manual_seed(_SEED)
        count = self.hypotheses * self.particles
        states, frames = states_of(as_read(motion), humor.body), int(motion.valid.sum())
        draws = LimbDraws.of(humor, motion.shape.expand(count, -1), unseen)
        state = draws.first(states[:, 0], random)
        weights = states.translation.new_zeros(self.hypotheses, self.particles)
        poses, parents = [state.pose], list[Tensor]()
        for frame in range(1, frames):
            step, reached, _ = drawn_step(humor.networks, state, draws.pelvis, random)
            predicted = step.leave(reached, draws.pelvis)
            known = states[:, frame].map(lambda tensor: tensor.expand(count, *tensor.shape[1:]))
            state = draws.completed(known, predicted)
            agreement = self._agreement(predicted, state, ~draws.nowhere)
            weights = weights + agreement.view_as(weights)
            poses.append(state.pose)
            parent, weights = self._resampled(weights, random, last=frame == frames - 1)
            parents.append(parent)
            state = state[parent]
        found = _paths(poses, parents, _best(weights))
        beyond = motion.rotations[:, frames:, 1:].expand(self.hypotheses, -1, -1, -1, -1)
        return torch.cat((found, beyond), 1)

    def _agreement(
        self, predicted: State, completed: State, seen: Bool[Tensor, " 22"]
    ) -> Float[Tensor, " particles"]:
        """Logarithm of the likelihood of what was seen, as of one joint; and of feet on ground."""
        place = (predicted.joints - completed.joints)[:, seen].square().sum(-1).mean(-1)
        speed = predicted.joint_velocities - completed.joint_velocities
        speed = speed[:, seen].square().sum(-1).mean(-1)
        low = (completed.joints[:, TOES, 2] - _SOLE).clamp(max=0).square().sum(-1)
        return -0.5 * (place / self.place**2 + speed / self.speed**2 + low / self.depth**2)

    def _resampled(
        self,
        weights: Float[Tensor, "hypotheses particles"],
        random: torch.Generator,
        *,
        last: bool,
    ) -> tuple[Int[Tensor, " all"], Float[Tensor, "hypotheses particles"]]:
        """The particle that each comes from, systematically drawn, and the weights after it."""
        share = weights.softmax(-1)
        few = (1 / share.square().sum(-1, keepdim=True) < self.least * self.particles) & (not last)
        own = torch.arange(self.particles, device=weights.device).expand_as(weights)
        offset = torch.rand(self.hypotheses, 1, generator=random).to(weights)
        drawn = torch.searchsorted(share.cumsum(-1), (offset + own) / self.particles)
        chosen = torch.where(few, drawn.clamp(max=self.particles - 1), own)
        first = torch.arange(self.hypotheses, device=weights.device)[:, None] * self.particles
        return (chosen + first).flatten(), torch.where(few, 0.0, weights)


@dataclass(frozen=True, eq=False)
class UnseenLimbs:
    """Proposes motions of limbs that no sensor saw (`recon.method.stages.Proposals`)."""

    humor: Humor
    unseen: Bool[Tensor, "clips 22"]
    """Joints whose rotations nobody saw; a clip without any gets no proposals."""
    filter: ParticleFilter = ParticleFilter()

    def __call__(self, estimate: Estimate, clip: int) -> Motion | None:
        """Motions of one clip that differ from the estimate in the unseen limbs."""
        unseen, motion = self.unseen[clip], estimate.motion.detach()
        if not bool(unseen.any()) or int(motion.valid.sum()) < 2:
            return None
        poses = self.filter(self.humor.like(motion.translation), motion, unseen)
        motions = motion.map(lambda tensor: tensor.expand(len(poses), *tensor.shape[1:]))
        return motions.replace(rotations=torch.cat((motions.rotations[:, :, :1], poses), 2))


def _best(weights: Float[Tensor, "hypotheses particles"]) -> Int[Tensor, " hypotheses"]:
    """The heaviest particle of every filter, as numbers among all."""
    filters = torch.arange(len(weights), device=weights.device)
    return weights.argmax(-1) + filters * weights.shape[-1]


def _paths(
    poses: list[Tensor], parents: list[Tensor], last: Int[Tensor, " hypotheses"]
) -> Float[Tensor, "hypotheses time 21 3 3"]:
    """The poses that led to particles of the last frame."""
    index, path = last, [poses[-1][last]]
    for pose, parent in zip(poses[-2:0:-1], parents[-2::-1], strict=True):
        index = parent[index]
        path.append(pose[index])
    path.append(poses[0][index])
    return torch.stack(path[::-1], 1)
