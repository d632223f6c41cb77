"""The zero-moment point, at which the ground must push for the body to move as it does."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.parts import GRAVITY
from recon.physics.dynamics import Dynamics

HUMOS_CODE_GRAVITY = 9.8
"""m/s², in the released code of HUMOS."""

LEAST_LOAD = 0.1
"""Share of the body's weight by which the ZMP divides at least; below, the body flies."""

FULL_LOAD = 0.3
"""Share of the body's weight from which on the ground counts as carrying it."""


def relative_load(dynamics: Dynamics) -> Float[Tensor, "*batch inner"]:
    """Normal force of the ground relative to the body's weight, N / (M g) = 1 + a_z / g.

    One for who stands still, zero in free fall, negative where nothing but a pull explains it.
    """
    return 1 + dynamics.acceleration[..., 2] / GRAVITY


def normal_force(dynamics: Dynamics) -> Float[Tensor, "*batch inner"]:
    """Normal force N = M (g + a_z), newtons (per kilogram if the mass is 1)."""
    return dynamics.mass[..., None] * GRAVITY * relative_load(dynamics)


def zmp(dynamics: Dynamics) -> Float[Tensor, "*batch inner 2"]:
    """Return the zero-moment point on the ground z = 0 in every inner frame, metres.

    Z = C + [n × Ḣ - M h a_xy] / N with n up, C the centre of mass on the ground, h its height and
    N no less than 0.1 M g. The sign is that of Newton and Euler; HUMOS equation 3 has it reversed.
    """
    floor = LEAST_LOAD * GRAVITY * dynamics.mass[..., None]
    return _zmp_by_force(dynamics, normal_force(dynamics).maximum(floor))


def zmp_of_humos_code(dynamics: Dynamics) -> Float[Tensor, "*batch inner 2"]:
    """Return the zero-moment point as HUMOS's released code computes it, metres.

    Its gravity points up and its sign is reversed: the two cancel but in the denominator, which
    is M (g - a_z): Z' - C = (Z - C) (g + a_z) / (g - a_z), singular in a push-off of 1 g.
    """
    force = dynamics.mass[..., None] * (HUMOS_CODE_GRAVITY - dynamics.acceleration[..., 2])
    return torch.nan_to_num(_zmp_by_force(dynamics, force), nan=0.0, posinf=0.0, neginf=0.0)


def share_carried(dynamics: Dynamics) -> Float[Tensor, "*batch inner"]:
    """Return a smooth weight: 0 if the ground carries under 0.1 of the body weight, 1 over 0.3."""
    return smoothstep(relative_load(dynamics), LEAST_LOAD, FULL_LOAD)


def smoothstep(x: Float[Tensor, "*shape"], low: float, high: float) -> Float[Tensor, "*shape"]:
    """Smooth step from 0 at `low` to 1 at `high`: 3 u² - 2 u³ in between."""
    u = ((x - low) / (high - low)).clamp(0, 1)
    return u * u * (3 - 2 * u)


def _zmp_by_force(dynamics: Dynamics, normal_force: Tensor) -> Tensor:
    centre, height = dynamics.centre[..., :2], dynamics.centre[..., 2:]
    inertia = dynamics.mass[..., None, None] * height * dynamics.acceleration[..., :2]
    turned = torch.stack((-dynamics.spin[..., 1], dynamics.spin[..., 0]), -1)
    return centre + (turned - inertia) / normal_force[..., None]


SUPPORT_HEIGHT = 0.05
"""Metres: skin below this and slower than the next supports the body (HUMOS's released code)."""

SUPPORT_SPEED = 0.4
"""m/s: 2 cm per frame at 20 fps."""


def can_carry_weight(
    vertices: Float[Tensor, "time vertices 3"], fps: float
) -> Bool[Tensor, "time vertices"]:
    """Mask of vertices that are low and slow enough to carry weight.

    Speeds are those to the next frame; the last frame has that of the frame before it.
    """
    step = vertices.diff(dim=0).norm(dim=-1) * fps
    speed = torch.cat((step, step[-1:])) if len(step) else torch.zeros_like(vertices[..., 0])
    return (vertices[..., 2] < SUPPORT_HEIGHT) & (speed < SUPPORT_SPEED)


def base_of_support(points: Float[Tensor, "points 2"]) -> Float[Tensor, "corners 2"] | None:
    """Convex hull of points on the ground, counter-clockwise; None where it has no area."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 3:
        return None
    try:
        corners = ConvexHull(points.detach().cpu().double().numpy()).vertices
    except QhullError:  # all points are on a line
        return None
    return points[torch.from_numpy(corners.astype(np.int64)).to(points.device)]


def signed_distance(
    point: Float[Tensor, "*points 2"], hull: Float[Tensor, "corners 2"]
) -> Float[Tensor, "*points"]:
    """Distance of points to the nearest edge of a convex hull, metres; negative inside."""
    edge = hull.roll(-1, 0) - hull
    away = point[..., None, :] - hull
    along = ((away * edge).sum(-1) / edge.square().sum(-1)).clamp(0, 1)
    distance = (away - along[..., None] * edge).norm(dim=-1).amin(-1)
    left = edge[:, 0] * away[..., 1] - edge[:, 1] * away[..., 0]
    return torch.where((left >= 0).all(-1), -distance, distance)


def distances_to_support(
    points: Float[Tensor, "time kinds 2"],
    vertices: Float[Tensor, "time vertices 3"],
    standing: Bool[Tensor, "time vertices"],
) -> tuple[Float[Tensor, "time kinds"], Bool[Tensor, " time"]]:
    """Return signed distances of points to the base of support, and a mask where it exists.

    Frames without a base have distance 0, as in HUMOS's released code.
    """
    distances = torch.zeros_like(points[..., 0])
    exists = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    for frame in range(len(points)):
        hull = base_of_support(vertices[frame, standing[frame], :2])
        if hull is not None:
            distances[frame] = signed_distance(points[frame], hull)
            exists[frame] = True
    return distances, exists


GAMMA = 30.0
"""Per metre above the ground: 5 cm up, a fifth of the pressure is left. HUMOS prints 10, but ran
30, the value its 25 cm rule follows from."""

ALPHA = 100.0
"""Per metre below the ground."""


def pressure(heights: Float[Tensor, "*shape"], decay: float = GAMMA) -> Float[Tensor, "*shape"]:
    """Pressure at height h: exp(-γ h) above the ground, 1 - α h below it (HUMOS, IPMAN)."""
    above = (-decay * heights.clamp(min=0)).exp()
    return above + ALPHA * (-heights).clamp(min=0)


def centre_of_pressure(
    points: Float[Tensor, "*batch points 3"], areas: Float[Tensor, " points"], decay: float = GAMMA
) -> Float[Tensor, "*batch 2"]:
    """Mean of skin points on the ground plane, weighted by pressure × area; metres.

    Heights alone cannot tell which of two equally low feet carries the body. A point exists
    however high the body is: gate it.
    """
    heights = points[..., 2]
    # lowering a flying body to the ground changes no ratio of weights, and avoids underflow
    floor = heights.detach().amin(-1, keepdim=True).clamp(min=0)
    weights = pressure(heights - floor, decay) * areas
    return (weights[..., None] * points[..., :2]).sum(-2) / weights.sum(-1, keepdim=True)
