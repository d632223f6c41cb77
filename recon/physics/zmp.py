"""Zero-moment point: where the ground must push for the body to move as it does."""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.physics.mass import Dynamics

GRAVITY = 9.81
"""m/s², downward."""

RELEASED_GRAVITY = 9.8
"""m/s², in the released code of HUMOS."""

LEAST_LOAD = 0.1
"""Share of the body's weight by which the ZMP divides at least; below, the body flies."""

FULL_LOAD = 0.3
"""Share of the body's weight from which on the ground counts as carrying it."""


def load(dynamics: Dynamics) -> Float[Tensor, "*batch inner"]:
    """Normal force of the ground as a share of the body's weight, N / (M g) = 1 + a_z / g.

    One for who stands still, zero in free fall, negative where nothing but a pull explains it.
    """
    return 1 + dynamics.acceleration[..., 2] / GRAVITY


def normal_force(dynamics: Dynamics) -> Float[Tensor, "*batch inner"]:
    """N = M (g + a_z), newtons (per kilogram where the mass is 1)."""
    return dynamics.mass[..., None] * GRAVITY * load(dynamics)


def zmp(dynamics: Dynamics) -> Float[Tensor, "*batch inner 2"]:
    """Point of z = 0 about which the ground's force has no horizontal moment, metres.

    Z = C + [n × Ḣ - M h a_xy] / N with n up, C the centre of mass on the ground, h its height and
    N no less than 0.1 M g. The sign is that of Newton and Euler; HUMOS equation 3 has it reversed.
    """
    floor = LEAST_LOAD * GRAVITY * dynamics.mass[..., None]
    return _divided(dynamics, normal_force(dynamics).maximum(floor))


def zmp_as_released(dynamics: Dynamics) -> Float[Tensor, "*batch inner 2"]:
    """The ZMP of HUMOS's released code, behind its published Dyn. Stability and BoS Dist; metres.

    Its gravity points up and its sign is reversed: the two cancel but in the denominator, which
    is M (g - a_z): Z' - C = (Z - C) (g + a_z) / (g - a_z), singular in a push-off of 1 g.
    """
    force = dynamics.mass[..., None] * (RELEASED_GRAVITY - dynamics.acceleration[..., 2])
    return torch.nan_to_num(_divided(dynamics, force), nan=0.0, posinf=0.0, neginf=0.0)


def supported(dynamics: Dynamics) -> Float[Tensor, "*batch inner"]:
    """Whether the ground carries the body: 0 below a tenth of its weight, 1 above 0.3."""
    return smoothstep(load(dynamics), LEAST_LOAD, FULL_LOAD)


def smoothstep(x: Float[Tensor, "*shape"], low: float, high: float) -> Float[Tensor, "*shape"]:
    """0 below low, 1 above high, 3 u² - 2 u³ between."""
    u = ((x - low) / (high - low)).clamp(0, 1)
    return u * u * (3 - 2 * u)


def _divided(dynamics: Dynamics, force: Tensor) -> Tensor:
    centre, height = dynamics.centre[..., :2], dynamics.centre[..., 2:]
    inertia = dynamics.mass[..., None, None] * height * dynamics.acceleration[..., :2]
    turned = torch.stack((-dynamics.spin[..., 1], dynamics.spin[..., 0]), -1)
    return centre + (turned - inertia) / force[..., None]
