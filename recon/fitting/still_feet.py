"""Holds feet still in space where they do not move in the image of the only view.

One view does not show whether a foot moves along its ray. A camera above the ground looks down at
feet, so that a foot on the ground moves in the image when it moves in space; a foot that is still
in the image stands, unless it happens to move along the ray. The networks of the motion prior may
take such a foot for one without contact, and let it slide towards the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.core.limits import FEW_MOMENTS
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.solver.banded import add_differences

_SPEED_STD_M_S = 0.15
"""Standard deviation (m/s) of a standing foot's speed across its ray, mostly by detector
errors."""
_SPAN_S = 5 / 30
"""Time (s) over which the speed of a foot across its ray is measured."""
_MIN_HOLD = 0.3
"""Value of h below which a foot is not held at all."""


@dataclass(frozen=True)
class StillFeet(TensorStruct):
    """Energy ½ Σ h |p_t - p_(t-1)|² of ankles and toes p, with weights h (0 to 1); m², 30 Hz."""

    held: Float[Tensor, "*batch steps 4"]
    """h = exp(-½ (v / 0.15 m/s)²) for the speed v of a foot across its ray, between frames."""
    fps: float
    start_time: float

    @classmethod
    def of(cls, view: Keypoints2D, body: BodyModel, pixel_size: float) -> "StillFeet":
        """Compute the weights h from the speeds of the person's feet in one view.

        Args:
            view: 2D keypoints, with the pose of their fixed or moving camera.
            body: body model with the feet.
            pixel_size: width of a pixel at the person, metres.
        """
        focal = view.camera.camera_matrix[..., [0, 1], [0, 1]].mean(-1)
        depth = (pixel_size * focal)[..., None].expand(view.confidence.shape)
        places = view.camera.unproject(view.pixels, depth)
        eye = view.camera.T_world_camera[..., None, :3, 3]
        half, last = round(_SPAN_S * view.fps / 2), view.moments - 1
        step = torch.arange(last, device=places.device)
        before, after = (step - half).clamp(min=0), (step + 1 + half).clamp(max=last)
        rays = torch.nn.functional.normalize((places - eye)[..., after, :, :], dim=-1)
        moved = places[..., after, :, :] - places[..., before, :, :]
        moved = moved - (moved * rays).sum(-1, keepdim=True) * rays
        speed = moved.norm(dim=-1) * (view.fps / (after - before))[:, None]
        # the speed of a joint is the mean over the keypoints that locate it
        seen = (view.shown[..., after, :] & view.shown[..., before, :]).to(places)
        tells = torch.from_numpy(view.located_joints(body)[:, FEET]).to(places)
        count = seen @ tells
        speed = (speed * seen) @ tells / count.clamp(min=1)
        held = (-0.5 * (speed / _SPEED_STD_M_S).square()).exp()
        return cls(held.where((held > _MIN_HOLD) & (count > 0), 0.0), view.fps, view.start_time)

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Return the energy, scaled to 30 frames per second."""
        motion = estimate.motion
        step = estimate.body.joints[..., FEET, :].diff(dim=-3).square().sum(-1)
        return 0.5 * (self._weights_at_steps(motion) * step).sum((-1, -2))

    def add_curvature(
        self, weight: float, estimate: Estimate, clip: int, joints: Float[Tensor, "time 3 66"]
    ) -> None:
        """Add the Hessian of the energy to `joints`; see `SupportEnergy.add_curvature`."""
        held = joints.new_zeros(len(joints) - 1, 22, 3)
        held[:, FEET] = weight * self._weights_at_steps(estimate.motion)[clip, ..., None].to(
            joints
        )
        add_differences(joints, (-1.0, 1.0), held.flatten(1))

    def _weights_at_steps(self, motion: Motion) -> Float[Tensor, "*batch steps 4"]:
        """Return the weights h of a motion's steps, multiplied by its frame rate / 30 Hz."""
        time = motion.start_time + torch.arange(motion.frames - 1) / motion.fps
        # 1e-3 frames are added, since rounding may put a time just before its frame
        row = ((time - self.start_time) * self.fps + 1e-3).floor().long()
        held = self.held[..., row.clamp(0, self.held.shape[-2] - 1).to(self.held.device), :]
        return (held * (motion.fps / REFERENCE_FPS)).where(motion.pairs[..., None], 0.0)


def with_still_feet(
    stages: Sequence[Stage[Any]], view: Keypoints2D, body: BodyModel, pixel_size: float
) -> tuple[Stage[Any], ...]:
    """Return the stages; feet that do not move in the image are held as if surely in contact.

    No feet are held at low frame rates, where a foot may leave and come back between two frames.
    """
    if view.fps < FEW_MOMENTS:
        return tuple(stages)

    def with_feet_held(stage: Stage[Any]) -> Stage[Any]:
        contact = next((one for one in stage.terms if one.name == "contact velocity"), None)
        if contact is None or stage.name != "contacts":
            return stage
        still = StillFeet.of(view, body, pixel_size)
        return replace(stage, terms=(*stage.terms, Term("still feet", still, contact.weight)))

    return tuple(map(with_feet_held, stages))
