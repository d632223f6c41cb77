"""Moments at hips, knees and ankles by inverse dynamics, in coordinates of OpenSim's models."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float

from recon.body.model import BodyModel
from recon.body.opensim import OpenSimModel, leg_axes
from recon.body.parts import GRAVITY, vertex_masses_of_segments
from recon.core.motion import Motion
from recon.core.skeleton import descendants, joint_index
from recon.physics.dynamics import body_dynamics, difference_step
from recon.physics.forces import GroundForces, repeat_ends
from recon.physics.plates import MeasuredForces

PLATE_STD, PLATE_CENTRE_STD_M = 0.01, 0.01
"""Standard deviations where plates measured: of forces in shares of the weight, and of the centre
of pressure relative to the joint, whose place is not known better."""
TWIST_STD = 0.05
"""Standard deviation of the ground's moment about the vertical that no plate measured, N m/kg."""
_JOINTS = {"hip": "hip", "knee": "knee", "ankle": "ankle", "subtalar": "ankle"}
"""The joint of a coordinate, by its first word."""


@dataclass(frozen=True)
class JointMoments:
    """Joint moments of the legs on the distal segment; positive ones increase the coordinate."""

    moments: dict[str, Float[np.ndarray, " time"]]
    """Newton metres, by the coordinate's name, such as `hip_flexion_r`."""
    std: dict[str, Float[np.ndarray, " time"]]
    """Standard deviations that follow from those of force, its place and its twist; N m."""
    measured: Bool[np.ndarray, "time 2"]
    """Whether a plate measured the force on the left and right foot; else it is estimated."""


def joint_moments(
    motion: Motion,
    body: BodyModel,
    forces: GroundForces,
    plates: MeasuredForces | None = None,
    model: OpenSimModel = "rajagopal2016",
) -> JointMoments:
    """Inverse dynamics of the legs from the feet upwards, by measured forces where there are some.

    M = Ḣ + (G - x) × m (a + g) - (P - x) × F - T, for all mass m below a joint at x, with its
    centre G and angular momentum H about it; F, P and T are force, centre of pressure and moment
    of the ground. Segments have de Leva's masses, and accelerations the cut-off of the forces.

    Args:
        motion: one clip that the forces are of.
        body: whose motion it is; the bundled one.
        forces: estimated ones.
        plates: measured ones.
        model: whose coordinates the moments have.

    Raises:
        ValueError: when the body is another one.
    """
    body = body.to(device="cpu", dtype=torch.float64)
    precise = motion.detach().to(device="cpu", dtype=torch.float64)
    posed, step = body.pose(precise), difference_step(motion.fps)
    masses = forces.mass * vertex_masses_of_segments(body)
    force, centre = forces.force.numpy().copy(), forces.centre.numpy().copy()
    force_std, centre_std = forces.force_std.numpy().copy(), forces.centre_std.numpy().copy()
    torque = np.zeros_like(force)
    known = np.zeros(force.shape[:2], dtype=bool) if plates is None else plates.known
    if plates is not None:
        force[known], centre[known] = plates.force[known], plates.centre[known]
        force_std[known], centre_std[known] = PLATE_STD * forces.mass * GRAVITY, PLATE_CENTRE_STD_M
        torque[known, 2] = plates.torque[known]
    moments: dict[str, Float[np.ndarray, " time"]] = {}
    std: dict[str, Float[np.ndarray, " time"]] = {}
    carrier = body.weights.argmax(-1)
    for name, axis in leg_axes(body, precise, model).items():
        word, end = name.split("_")[0], name[-1]
        if word not in _JOINTS:
            continue
        side = int(end == "r")
        joint = joint_index(f"{('left', 'right')[side]}_{_JOINTS[word]}")
        below = torch.isin(carrier, torch.tensor(descendants(joint)))
        moving = body_dynamics(posed, masses * below, motion.fps)
        place = posed.joints[:, joint].numpy()
        mass = float(moving.mass)
        pull = mass * repeat_ends(moving.acceleration, step).numpy() + [0, 0, mass * GRAVITY]
        arm = repeat_ends(moving.centre, step).numpy() - place
        own = repeat_ends(moving.spin, step).numpy() + np.cross(arm, pull)
        lever, load = centre[:, side] - place, force[:, side]
        whole = own - np.cross(lever, load) - torque[:, side]
        moments[name] = (whole * axis).sum(-1)
        by_force = (np.cross(axis, lever) * force_std[:, side]) ** 2
        by_place = (np.cross(load, axis)[:, :2] * centre_std[:, side, None]) ** 2
        by_twist = (axis[:, 2] * TWIST_STD * forces.mass * (load.any(-1) & ~known[:, side])) ** 2
        std[name] = np.sqrt(by_force.sum(-1) + by_place.sum(-1) + by_twist)
    return JointMoments(moments, std, known)
