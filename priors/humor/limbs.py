"""Unobserved limbs: which they are, draws of their first state, and particles that continue it."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.humor.generation import drawn_step
from priors.humor.prior import Humor
from priors.humor.state import (
    Frame,
    State,
    initial_features,
    on_network_clock,
    posed_joints,
    states_of,
)
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS, TOES, descendants
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor
from recon.method.terms import Term

_SELDOM = 1 / 3
"""A joint that is told in a smaller share of the moments than this counts as not seen."""
_BENDING = tuple(JOINTS.index(f"{side}_{name}") for side in ("left", "right")
                 for name in ("knee", "elbow"))  # fmt: skip
"""Joints one of which must be unseen for a limb to be."""
_PLACE, _SPEED, _TURNING = 0.04, 0.3, 1.0
"""Standard deviations of what the mixture of first states is told of the seen part: of joints,
metres; of their velocities, m/s; and of the angular velocity, rad/s."""


def unseen_limbs(data: Sequence[Term], body: BodyModel) -> Bool[Tensor, "clips 22"] | None:
    """Joints whose rotations are unobserved: no sensor saw a point at or below them in the tree.

    A joint at the end of a limb, whose rotation moves no other joint, counts as its parent does.
    Clips in which every knee and elbow is told have none. None where no clip has unseen limbs,
    or where a sensor knows no points of the body, as a depth sensor does not.
    """
    located = [
        joints >= _SELDOM
        for term in data
        if isinstance(term.energy, Sensor)
        and (joints := term.energy.share_of_frames_locating(body)) is not None
    ]
    if len(located) == 0 or len(located) < len(data):
        return None
    seen = torch.stack(located).any(0)
    unseen = torch.zeros_like(seen)
    for joint in range(1, len(JOINTS)):
        below = list(descendants(joint))[1:]
        unseen[:, joint] = ~seen[:, below].any(-1) if below else unseen[:, PARENTS[joint]]
    unseen &= unseen[:, list(_BENDING)].any(-1, keepdim=True)
    return unseen if bool(unseen.any()) else None


@dataclass(frozen=True)
class LimbDraws:
    """The body shapes and unobserved joints that the particles of one clip share."""

    humor: Humor
    pelvis: Float[Tensor, "particles 3"]
    """Place of the pelvis of the bodies at rest, horizontally."""
    rest: Float[Tensor, "particles 22 3"]
    """Joints of the unposed bodies, metres."""
    unseen: Bool[Tensor, " 22"]
    """Joints of unknown rotation."""
    nowhere: Bool[Tensor, " 22"]
    """Joints of unknown place: a joint is where its parent's rotation puts it."""

    @classmethod
    def of(
        cls, humor: Humor, shape: Float[Tensor, "particles shape"], unseen: Bool[Tensor, " 22"]
    ) -> "LimbDraws":
        """The data that all particles share, for particles with these body shapes."""
        parents = torch.tensor([max(parent, 0) for parent in PARENTS], device=unseen.device)
        nowhere = unseen[parents]
        return cls(humor, humor.pelvis(shape), humor.body.rest_joints(shape), unseen, nowhere)

    def completed(self, known: State, drawn: State) -> State:
        """States with the observed joints of `known` and the unobserved limbs of `drawn`."""
        velocities = torch.where(
            self.nowhere[:, None], drawn.joint_velocities, known.joint_velocities
        )
        pose = torch.where(self.unseen[1:, None, None], drawn.pose, known.pose)
        completed = known.replace(pose=pose, joint_velocities=velocities)
        return completed.replace(joints=posed_joints(completed, self.rest))

    def first(self, state: State, random: torch.Generator) -> State:
        """First states drawn from the mixture of initial states, conditioned on the observed part.

        Args:
            state: in the world, axis (1).
            random: of the draws.
        """
        count = len(self.pelvis)
        state = state.map(lambda tensor: tensor.expand(count, *tensor.shape[1:]))
        frame = Frame.of(state)
        here = frame.to_frame(state, self.pelvis)
        mixture = self.humor.initial
        numbers = initial_features(here)[0].double()
        known = ~self._drawn_features()[mixture.features]
        std = self._deviations().to(numbers)[mixture.features]
        others = mixture.conditioned_on(known, numbers[mixture.features][known], std[known])
        drawn = numbers.repeat(count, 1)
        drawn[:, others.features] = others.sample(count, random)
        points, velocities = (
            part.unflatten(-1, (len(JOINTS), 3)).to(state.joints)
            for part in drawn[:, :-6].chunk(2, 1)
        )
        begun = here.replace(
            pose=self._bones_pointing_at(here, points), joint_velocities=velocities
        )
        return self.completed(state, frame.from_frame(begun, self.pelvis))

    def _drawn_features(self) -> Bool[Tensor, " 138"]:
        """Mask of the `initial_features` that are drawn at random.

        Positions and velocities of unobserved joints.
        """
        joints = self.nowhere.repeat_interleave(3)
        return torch.cat((joints, joints, torch.zeros_like(joints[:6])))

    def _deviations(self) -> Float[Tensor, " 138"]:
        """Standard deviations of `initial_features` where they are known."""
        parts = ((66, _PLACE), (66, _SPEED), (3, _SPEED / 2), (3, _TURNING))
        return torch.cat([torch.full((count,), std) for count, std in parts])

    def _bones_pointing_at(
        self, state: State, points: Float[Tensor, "particles 22 3"]
    ) -> Float[Tensor, "particles 21 3 3"]:
        """Rotations that point the bones of unobserved limbs at given joints, trunk first."""
        rotations = list(torch.cat((state.root[:, None], state.pose), 1).unbind(1))
        world = [rotations[0]]
        for joint in range(1, len(JOINTS)):
            parent = world[PARENTS[joint]]
            posed = parent @ rotations[joint]
            if bool(self.unseen[joint]) and joint in PARENTS:
                child = PARENTS.index(joint)
                bone = (self.rest[:, child] - self.rest[:, joint])[..., None]
                turn = so3.between((posed @ bone)[..., 0], points[:, child] - points[:, joint])
                posed = turn @ posed
                rotations[joint] = parent.mT @ posed
            world.append(posed)
        return torch.stack(rotations[1:], 1)


_SOLE = 0.02
"""Height of a toe joint above the ground when the foot stands, metres."""
_SEED = 0


@dataclass(frozen=True)
class ParticleFilter:
    """Settings of the particle filter, chosen on the validation windows (docs/priors.md).

    Twice as many particles made hidden legs no better.
    """

    hypotheses: int = 4
    """Filters, each of which gives one motion."""
    particles: int = 64
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
        """Rotations of the body joints for each hypothesis; observed joints keep the motion's.

        Args:
            humor: the prior, of the motion's precision.
            motion: of one clip in the world, on the ground z = 0, whose frames are steps of the
                networks; axes (1, time).
            unseen: joints whose rotations are to be found.
        """
        random = torch.Generator().manual_seed(_SEED)
        count = self.hypotheses * self.particles
        states, frames = states_of(on_network_clock(motion), humor.body), int(motion.valid.sum())
        draws = LimbDraws.of(humor, motion.shape.expand(count, -1), unseen)
        state = draws.first(states[:, 0], random)
        weights = states.translation.new_zeros(self.hypotheses, self.particles)
        poses, parents = [state.pose], list[Tensor]()
        for frame in range(1, frames):
            step, reached, _ = drawn_step(humor.networks, state, draws.pelvis, random)
            predicted = step.from_frame(reached, draws.pelvis)
            known = states[:, frame].map(lambda tensor: tensor.expand(count, *tensor.shape[1:]))
            state = draws.completed(known, predicted)
            agreement = self._log_likelihood(predicted, state, ~draws.nowhere)
            weights = weights + agreement.view_as(weights)
            poses.append(state.pose)
            parent, weights = self._resampled(weights, random, last=frame == frames - 1)
            parents.append(parent)
            state = state[parent]
        found = _trajectories_to(poses, parents, _heaviest_particles(weights))
        beyond = motion.rotations[:, frames:, 1:].expand(self.hypotheses, -1, -1, -1, -1)
        return torch.cat((found, beyond), 1)

    def _log_likelihood(
        self, predicted: State, completed: State, seen: Bool[Tensor, " 22"]
    ) -> Float[Tensor, " particles"]:
        """Log-likelihood of the observed joints (their mean), and of feet on the ground."""
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
        """Systematic resampling: the ancestor of each particle, and the weights afterwards."""
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
        """Proposed motions of one clip that differ from the estimate in the unobserved limbs."""
        unseen, motion = self.unseen[clip], estimate.motion.detach()
        if not bool(unseen.any()) or int(motion.valid.sum()) < 2:
            return None
        poses = self.filter(self.humor.like(motion.translation), motion, unseen)
        motions = motion.map(lambda tensor: tensor.expand(len(poses), *tensor.shape[1:]))
        return motions.replace(rotations=torch.cat((motions.rotations[:, :, :1], poses), 2))


def _heaviest_particles(
    weights: Float[Tensor, "hypotheses particles"],
) -> Int[Tensor, " hypotheses"]:
    """Index, among all particles, of the particle with the largest weight in every filter."""
    filters = torch.arange(len(weights), device=weights.device)
    return weights.argmax(-1) + filters * weights.shape[-1]


def _trajectories_to(
    poses: list[Tensor], parents: list[Tensor], last: Int[Tensor, " hypotheses"]
) -> Float[Tensor, "hypotheses time 21 3 3"]:
    """The trajectories of poses that lead to the particles of the last frame."""
    index, path = last, [poses[-1][last]]
    for pose, parent in zip(poses[-2:0:-1], parents[-2::-1], strict=True):
        index = parent[index]
        path.append(pose[index])
    path.append(poses[0][index])
    return torch.stack(path[::-1], 1)
