"""Retargeting without a network: a motion and a body of another shape in, that body's motion out.

Copies, a scaled path, inverse kinematics of the feet, and the physics energies alone. The body
model is the first argument of each; the ground is z = 0; rate and frames stay.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.retarget_clips import grounded
from recon.body import motion_files as reshape
from recon.body.model import BodyModel, PosedBody
from recon.body.motion_files import leg_length, with_shape
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.fitting.retargeting import flies, settled

LEGS = ((1, 4, 7, 10), (2, 5, 8, 11))
"""Hip, knee, ankle and toe joints of the left and the right leg."""

ON_GROUND, OFF_GROUND = 0.015, 0.03
"""Metres: a sole below the first is put on the ground, one above the second keeps its height."""


def copied(body: BodyModel, motion: Motion, shape: Float[Tensor, " shape"]) -> Motion:
    """A motion with unchanged rotations and an unchanged path of the pelvis."""
    return reshape.copied(motion, body, shape)


def copied_to_ground(body: BodyModel, motion: Motion, shape: Float[Tensor, " shape"]) -> Motion:
    """The copy, lifted or lowered as a whole until its lowest point touches the ground."""
    return grounded(copied(body, motion, shape), body, 0.0)


def scaled(body: BodyModel, motion: Motion, shape: Float[Tensor, " shape"]) -> Motion:
    """A motion of equal rotations, the path grown with the legs, grounded as recordings are."""
    return grounded(with_shape(motion, body, shape), body)


def foot_ik(body: BodyModel, motion: Motion, shape: Float[Tensor, " shape"]) -> Motion:
    """The scaled motion with legs that reach for the scaled places of the source's feet.

    Frame by frame: the middle between ankle and toe joint is where the source has it, scaled as
    the path is; the sole is as high as the source's, or on the ground; the foot's direction in
    the world stays. Two bones reach that in closed form, the knee bending in its own plane.
    """
    start = scaled(body, motion, shape)
    source, posed = body.pose(motion), body.pose(start)
    origin = source.joints[:1, 0, :2]
    ratio = leg_length(body, shape) / leg_length(body, motion.shape)
    level, own = sole_heights(source), sole_heights(posed)
    wanted = torch.minimum(
        level.clamp(min=0),
        ((level - ON_GROUND) * OFF_GROUND / (OFF_GROUND - ON_GROUND)).clamp(min=0),
    )
    rotations = start.rotations.clone()
    for side, leg in enumerate(LEGS):
        hip, knee, ankle, toe = leg
        middle = (source.joints[:, ankle] + source.joints[:, toe])[:, :2] / 2
        foot = (posed.joints[:, toe] - posed.joints[:, ankle])[:, :2] / 2
        height = wanted[:, side] + posed.joints[:, ankle, 2] - own[:, side]
        goal = torch.cat((origin + ratio * (middle - origin) - foot, height[:, None]), -1)
        thigh, shin = _reaching(posed, leg, goal)
        rotations[:, hip] = posed.orientations[:, 0].mT @ thigh
        rotations[:, knee] = thigh.mT @ shin
        rotations[:, ankle] = shin.mT @ posed.orientations[:, ankle]
    return start.replace(rotations=rotations)


def physics_only(body: BodyModel, motion: Motion, shape: Float[Tensor, " shape"]) -> Motion:
    """The smooth motion nearest to the scaled one that obeys the physics energies."""
    start = scaled(body, motion, shape)[None].replace(valid=motion.valid[None])
    return settled(start, start, flies(motion, body)[None], body)[0]


def sole_heights(posed: PosedBody) -> Float[Tensor, "time 2"]:
    """Height of the lowest vertex of the left and the right foot, metres."""
    owner = posed.model.weights.argmax(-1)
    feet = [torch.isin(owner, owner.new_tensor(leg[2:])).nonzero()[:, 0] for leg in LEGS]
    return torch.stack([posed.points(foot)[..., 2].amin(-1) for foot in feet], -1)


def _reaching(
    posed: PosedBody, leg: tuple[int, int, int, int], goal: Float[Tensor, "time 3"]
) -> tuple[Float[Tensor, "time 3 3"], Float[Tensor, "time 3 3"]]:
    """World rotations of thigh and shin that bring the ankle to the goal, or as near as it gets.

    With bones a, b and the distance d, the knee bends by arccos((d² - a² - b²) / 2ab).
    """
    hip, knee, ankle, _ = leg
    thigh, shin = (posed.orientations[:, joint] for joint in (hip, knee))
    h, k, end = (posed.joints[:, joint] for joint in (hip, knee, ankle))
    upper, lower = (k - h), (end - k)
    a, b = upper.norm(dim=-1), lower.norm(dim=-1)
    d = (goal - h).norm(dim=-1).minimum(0.999 * (a + b)).maximum(1.001 * (a - b).abs())
    bend = ((d**2 - a**2 - b**2) / (2 * a * b)).clamp(-1, 1).acos()[:, None]
    along = upper / a[:, None]
    # a straight leg has no plane of its own: it bends about the thigh's left
    axis = torch.linalg.cross(along, lower / b[:, None]) + 0.05 * thigh[..., 0]
    axis = axis - (axis * along).sum(-1, keepdim=True) * along
    axis = axis / axis.norm(dim=-1, keepdim=True)
    bent = bend.cos() * along + bend.sin() * torch.linalg.cross(axis, along)
    turn_knee = _between(lower, bent)
    turn_hip = _between(upper + b[:, None] * bent, goal - h)
    return turn_hip @ thigh, turn_hip @ turn_knee @ shin


def _between(a: Float[Tensor, "time 3"], b: Float[Tensor, "time 3"]) -> Float[Tensor, "time 3 3"]:
    """The smallest rotation from one direction to another."""
    across = torch.linalg.cross(a, b)
    sine = across.norm(dim=-1, keepdim=True)
    angle = torch.atan2(sine, (a * b).sum(-1, keepdim=True))
    return so3.exp(angle * across / sine.clamp(min=1e-12))


def soles_down(motion: Motion, body: BodyModel) -> Bool[Tensor, "time 2"]:
    """Feet in contact: the lowest point under 1.5 cm."""
    return sole_heights(body.pose(motion)) < ON_GROUND
