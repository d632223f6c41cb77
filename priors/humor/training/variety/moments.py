"""Windows as rotations over time, before joints and velocities are computed from them.

Edits change these rotations and translations at every moment alike, those beside the frames
included, from whose differences velocities are taken; so velocities always belong to positions.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.kinematics import forward_kinematics
from recon.core.skeleton import CONTACT_JOINTS
from recon.core.struct import TensorStruct

PER_FRAME = 3
"""Moments of every frame: one just before it, itself, and one just after."""

CHANNELS = {joint: channel for channel, joint in enumerate(CONTACT_JOINTS)}
"""Channel of the contact labels by joint."""


@dataclass(frozen=True)
class Moments(TensorStruct):
    """Windows of motion in the world: z up, metres, seconds; frame by frame, moment by moment."""

    translation: Float[Tensor, "windows times 3"]
    rotations: Float[Tensor, "windows times 22 3 3"]
    contacts: Bool[Tensor, "windows frames 9"]
    """Whether a joint of `CONTACT_JOINTS` carries weight."""
    seconds: Float[Tensor, "windows times"]
    """Time of every moment as the window is played, zero at its first frame."""
    rest: Float[Tensor, "windows 22 3"]
    """Joints of the unposed bodies."""

    def posed(
        self,
    ) -> tuple[Float[Tensor, "windows times 22 3 3"], Float[Tensor, "windows times 22 3"]]:
        """World orientations and positions of all joints."""
        orientations, joints = forward_kinematics(self.rotations, self.rest)
        return orientations, joints + self.translation[:, :, None]

    def always(self, *joints: int) -> Bool[Tensor, " windows"]:
        """Whether each of these joints is in contact in every frame."""
        return self.contacts[..., [CHANNELS[j] for j in joints]].flatten(1).all(1)

    def ever(self, *joints: int) -> Bool[Tensor, " windows"]:
        """Whether one of these joints is in contact in any frame."""
        return self.contacts[..., [CHANNELS[j] for j in joints]].flatten(1).any(1)


def with_edited(
    moments: Moments,
    rows: Int[Tensor, " some"],
    edited: Moments,
    accepted: Bool[Tensor, " some"],
) -> Moments:
    """Windows of which some rows are exchanged, where the edit was accepted."""
    kept = rows[accepted]

    def exchanged(old: Tensor, new: Tensor) -> Tensor:
        return old.index_put((kept,), new[accepted])

    return moments.derived(
        translation=exchanged(moments.translation, edited.translation),
        rotations=exchanged(moments.rotations, edited.rotations),
        contacts=exchanged(moments.contacts, edited.contacts),
    )


def at_frames(values: Float[Tensor, "windows times *rest"]) -> Tensor:
    """Values at the frames themselves."""
    return values[:, 1::PER_FRAME]


def speeds(
    seconds: Float[Tensor, "windows times"], places: Float[Tensor, "windows times joints 3"]
) -> Float[Tensor, "windows frames joints"]:
    """Speeds at the frames, m/s, from the moments beside them."""
    span = (seconds[:, 2::PER_FRAME] - seconds[:, ::PER_FRAME])[..., None, None]
    return ((places[:, 2::PER_FRAME] - places[:, ::PER_FRAME]) / span).norm(dim=-1)


def forward_of(roots: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3"]:
    """Horizontal unit vectors in which bodies face: from their left side, turned by 90 degrees."""
    left = roots[..., 0]
    ahead = torch.stack((left[..., 1], -left[..., 0], torch.zeros_like(left[..., 0])), -1)
    return ahead / ahead.norm(dim=-1, keepdim=True).clamp(min=1e-6)
