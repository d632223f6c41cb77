"""Point masses: what the dynamics of bodies are compared with."""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.physics.dynamics import Dynamics, inner_frames, second_differences


def points_dynamics(
    points: Float[Tensor, "*batch time points 3"],
    masses: Float[Tensor, "*batch points"],
    fps: float,
) -> Dynamics:
    """Dynamics of point masses."""
    total = masses.sum(-1)
    share = (masses / total[..., None])[..., None, :, None]
    accelerations, places = second_differences(points, fps), inner_frames(points, fps)
    centre = (share * places).sum(-2)
    arms = places - centre[..., None, :]
    spin = (share * torch.linalg.cross(arms, accelerations, dim=-1)).sum(-2)
    return Dynamics(
        mass=total,
        centre=centre,
        acceleration=(share * accelerations).sum(-2),
        spin=total[..., None, None] * spin,
    )
