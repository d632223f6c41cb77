"""What one camera cannot tell: a larger person farther away looks the same."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from observations.together import kinds
from observations.together.first_guess import one_clock
from observations.together.triangulation import tell_distance
from recon.body.identities import height
from recon.body.model import BodyModel
from recon.fitting.clip import ClipFit
from recon.method.laplace.deviations import Deviations

_STEP = 0.01
_TELLING = frozenset({"height", "known shape"})
"""Terms by which a caller tells how large the person is."""


def size_is_unknown(found: ClipFit) -> bool:
    """Whether nothing but images of one place, without a ground, tells how large the person is.

    Perspective alone would, if bodies and detections were exact; they are not.
    """
    views = kinds.views(found.observations)
    if found.ground_known or len(views) == 0 or len(views) < len(found.observations):
        return False
    stages = [report.stage for report in found.result.reports]
    told = any(term.name in _TELLING for stage in stages for term in stage.terms)
    if told or not any("shape" in stage.free for stage in stages):
        return False
    alike = one_clock(views)
    return len(alike) == 1 or not tell_distance(alike)


def with_unknown_size(deviations: Deviations, found: ClipFit) -> Deviations:
    """Deviations of a person who may be larger or smaller, as people are, and farther or nearer.

    Everything is scaled about the camera by a factor whose standard deviation is that of people's
    heights.
    """
    estimate = found.result.estimate
    body = estimate.body.model.to(dtype=torch.float64)
    along = _height_direction(body, estimate.motion.shape[0].detach().double())
    tall = float(height(body, estimate.motion.shape[0].detach().double()))
    factor = float(along.norm()) / tall
    camera = kinds.views(found.observations)[0].camera
    eye = camera.T_world_camera[0].reshape(-1, 4, 4)[:, :3, 3].mean(0)
    joints = estimate.scene.to_recording(estimate.body.joints)[0].detach()
    distance = (joints - eye).norm(dim=-1).to(deviations.joints)
    ground = deviations.ground
    if ground is not None:
        above = float((found.T_world_recording[0].to(eye) @ torch.cat((eye, eye.new_ones(1))))[2])
        spread = (ground.height**2 + (factor * above) ** 2) ** 0.5
        ground = replace(ground, height=spread)
    shape = (along / along.norm()).to(deviations.shape)
    return replace(
        deviations,
        # one of three axes, whichever it is, points along the ray
        joints=(deviations.joints.square() + (factor * distance).square() / 3).sqrt(),
        shape=(deviations.shape.square() + shape.square()).sqrt(),
        ground=ground,
    )


def _height_direction(body: BodyModel, shape: Float[Tensor, " shape"]) -> Float[Tensor, " shape"]:
    """Metres that a standard deviation of every coefficient adds to the height."""
    steps = shape + _STEP * torch.eye(len(shape)).to(shape)
    return torch.stack([(height(body, one) - height(body, shape)) / _STEP for one in steps])
