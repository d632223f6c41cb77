"""Legs and arms that an estimate of the motion exchanged for moments, found by their jumps."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.motion import Motion
from recon.core.skeleton import MIRROR

_SWITCH = 0.18
"""Root mean square angle over the joints of both limbs, radians, whose square a change of sides
costs. It and the next number are chosen on validation windows: of frames whose legs are exchanged
by more than 0.3 radians nine in ten are found, and no motion is blamed that is as it should be."""
_STAY = 0.005
"""Cost of an exchanged frame, radians², so that the sides held most of the time are right."""

_FLIP = torch.tensor([-1.0, 1.0, 1.0])


def exchanged_frames(
    rotations: Float[Tensor, "time joints 3 3"], mirrored: Float[Tensor, "time joints 3 3"]
) -> Bool[Tensor, " time"]:
    """Frames in which limbs move more steadily when each does what the other does, mirrored.

    The sides of every frame are chosen together so that Σ ½ |angle|² from frame to frame is
    least, plus what changes of sides and exchanged frames cost (Viterbi's algorithm).

    Args:
        rotations: local rotations of both limbs' joints.
        mirrored: the same with the limbs exchanged.
    """
    both = torch.stack((rotations, mirrored), 1).double()
    step = both[1:, :, None] - both[:-1, None, :]  # axes (time, to, from, joints, 3, 3)
    squared = step.square().sum((-1, -2)).mean(-1) / 2  # angle², nearly
    switch = _SWITCH**2 * (1 - torch.eye(2, dtype=torch.float64))
    stay = torch.tensor([0.0, _STAY], dtype=torch.float64)
    cost, before = stay.clone(), []
    for frame in squared:
        total = cost[None, :] + frame + switch
        before.append(total.argmin(1))
        cost = total.min(1).values + stay
    state = int(cost.argmin())
    states = [state]
    for back in reversed(before):
        state = int(back[state])
        states.append(state)
    return torch.tensor(states[::-1], dtype=torch.bool)


def mirrored_limbs(motion: Motion, joints: tuple[int, ...]) -> Float[Tensor, "time joints 3 3"]:
    """Local rotations of both limbs' joints with left and right exchanged."""
    flip = _FLIP.to(motion.rotations)
    other = [MIRROR[joint] for joint in joints]
    return flip[:, None] * motion.rotations[:, other] * flip
