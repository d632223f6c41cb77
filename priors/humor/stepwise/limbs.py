"""Limbs that no sensor saw: which they are, how they may begin, and states with them filled in."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humor.prior import Humor
from priors.humor.state import Frame, State, initial_features, posed_joints
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS, PARENTS, descendants
from recon.method.protocols import TrackedJoints
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
    """Joints whose rotations no sensor tells, because it saw nothing that hangs from them.

    A joint at the end of a limb, whose rotation moves no other joint, counts as its parent does.
    Clips in which every knee and elbow is told have none. None where no clip has unseen limbs,
    or where a sensor knows no points of the body, as a depth sensor does not.
    """
    told = [
        term.energy.told_joints(body) >= _SELDOM
        for term in data
        if isinstance(term.energy, TrackedJoints)
    ]
    if len(told) == 0 or len(told) < len(data):
        return None
    seen = torch.stack(told).any(0)
    unseen = torch.zeros_like(seen)
    for joint in range(1, len(JOINTS)):
        below = list(descendants(joint))[1:]
        unseen[:, joint] = ~seen[:, below].any(-1) if below else unseen[:, PARENTS[joint]]
    unseen &= unseen[:, list(_BENDING)].any(-1, keepdim=True)
    return unseen if bool(unseen.any()) else None


@dataclass(frozen=True)
class LimbDraws:
    """Particles of one clip have these bodies and unseen joints in common."""

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
        """The particles of bodies of these shapes."""
        parents = torch.tensor([max(parent, 0) for parent in PARENTS], device=unseen.device)
        nowhere = unseen[parents]
        return cls(humor, humor.pelvis(shape), humor.body.rest_joints(shape), unseen, nowhere)

    def completed(self, known: State, drawn: State) -> State:
        """The known states with the unseen limbs of others."""
        velocities = torch.where(
            self.nowhere[:, None], drawn.joint_velocities, known.joint_velocities
        )
        pose = torch.where(self.unseen[1:, None, None], drawn.pose, known.pose)
        completed = known.replace(pose=pose, joint_velocities=velocities)
        return completed.replace(joints=posed_joints(completed, self.rest))

    def first(self, state: State, random: torch.Generator) -> State:
        """Draws of a first state: the mixture of initial states, given the seen part of one.

        Args:
            state: in the world, axis (1).
            random: of the draws.
        """
        count = len(self.pelvis)
        state = state.map(lambda tensor: tensor.expand(count, *tensor.shape[1:]))
        frame = Frame.of(state)
        here = frame.enter(state, self.pelvis)
        mixture = self.humor.initial
        numbers = initial_features(here)[0].double()
        known = ~self._drawn_features()[mixture.features]
        std = self._deviations().to(numbers)[mixture.features]
        others = mixture.given(known, numbers[mixture.features][known], std[known])
        drawn = numbers.repeat(count, 1)
        drawn[:, others.features] = others.sample(count, random)
        points, velocities = (
            part.unflatten(-1, (len(JOINTS), 3)).to(state.joints)
            for part in drawn[:, :-6].chunk(2, 1)
        )
        begun = here.replace(pose=self._aimed(here, points), joint_velocities=velocities)
        return self.completed(state, frame.leave(begun, self.pelvis))

    def _drawn_features(self) -> Bool[Tensor, " 138"]:
        """The mask of `initial_features` that are drawn: places and velocities of joints."""
        joints = self.nowhere.repeat_interleave(3)
        return torch.cat((joints, joints, torch.zeros_like(joints[:6])))

    def _deviations(self) -> Float[Tensor, " 138"]:
        """Standard deviations of `initial_features` where they are known."""
        parts = ((66, _PLACE), (66, _SPEED), (3, _SPEED / 2), (3, _TURNING))
        return torch.cat([torch.full((count,), std) for count, std in parts])

    def _aimed(
        self, state: State, points: Float[Tensor, "particles 22 3"]
    ) -> Float[Tensor, "particles 21 3 3"]:
        """Rotations that turn the bones of unseen limbs, from the trunk outwards, to points."""
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
