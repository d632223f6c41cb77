"""Forces between the feet and the ground, estimated from a motion and its mass alone.

Newton gives the whole force, and the zero-moment point says how two feet that stand share it.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.identities import body_weight
from recon.body.model import BodyModel
from recon.body.parts import GRAVITY, vertex_masses_of_segments
from recon.body.soles import Soles
from recon.core.arrays import runs_of_true
from recon.core.errors import ReconError
from recon.core.limits import Limit
from recon.core.motion import MotionFile
from recon.core.skeleton import FEET
from recon.physics.dynamics import Dynamics, body_dynamics, difference_step
from recon.physics.zmp import FULL_LOAD, centre_of_pressure, relative_load, zmp

CONTACT_HEIGHT_M = 0.04
"""A foot stands whose sole has a point below this that is slower than the next."""
CONTACT_SPEED_M_S = 0.4
SHORTEST_S = 0.08
"""Seconds that a foot stands, or is away, at least."""
SOLE_DECAY = 150.0
"""Per metre above the ground, by which the pressure under a shoe falls."""
OUT_OF_REACH_M = 0.35
"""Distance of the zero-moment point from the feet beyond which something else carries the body."""
LEVEL = 0.02
"""Slope of the ground up to which it counts as level."""
LEAST_HEIGHT_M = 0.3
"""Height of the centre of mass by which the slope of a force is divided, at least."""
MASS = Limit("mass of a person", 2.0, 400.0, "kg", "newborns have 3 kg: give kilograms")
SHAPE_MASS_SHARE = 0.1
"""Standard deviation of a mass that is told from the shape, as a share of it."""
VERTICAL_STD, ACROSS_STD = 0.045, (0.018, 0.03)
"""Standard deviations of a foot's force in shares of the weight, upwards, and across of one that
stands alone and of two. These and the next were chosen on plates (benchmarks/forces.toml)."""
TIMING_STD_S = 0.011
"""Standard deviation of the moment at which the weight goes over to the other foot."""
LEVER_SHARE = 0.7
"""Share of the misfit by which the lever of two feet errs."""
TILT_STD = 0.45
"""Share of the weight by which forces across err per metre that the zero-moment point errs."""
CENTRE_STD_M, CENTRE_MISFIT = 0.011, 0.2
"""Standard deviation of a coordinate of the centre of pressure, and its share of the misfit."""
PRESSED_STD_M = 0.026
"""Distance at which the lowest points of a sole tell the centre of pressure."""
USUAL_MISFIT_M = 0.06
"""Distance of the zero-moment point from the feet, where a clip has no frame on one foot."""
SMOOTH_S = 0.06
"""Standard deviation of the Gaussian that smooths the centre of pressure of a stance."""
STEP_S = 0.06
"""Seconds around double support within which the share of the feet is uncertain."""
DRIFT_S = 0.3
"""Time over which the error of an uncertain joint changes (`recon.body.contacts`)."""


@dataclass(frozen=True)
class GroundForces:
    """Estimated ground reaction force of each foot in every frame; world coordinates, z up."""

    force: Float[Tensor, "time 2 3"]
    """On the body, newtons; zero for a foot in the air."""
    centre: Float[Tensor, "time 2 3"]
    """Centre of pressure under each foot, metres; in the air, that of its lowest points."""
    force_std: Float[Tensor, "time 2 3"]
    """Standard deviations of the force, newtons."""
    centre_std: Float[Tensor, "time 2"]
    """Standard deviation of each horizontal coordinate of the centre, metres."""
    contact: Bool[Tensor, "time 2"]
    """Whether the foot stands and carries the body."""
    mass: float
    """kg."""
    notes: tuple[str, ...]
    """How mass, accelerations and shares of the feet were told."""
    warnings: tuple[str, ...]
    """A mass that nobody gave, and frames in which the feet do not carry the body."""


def ground_forces(file: MotionFile, body: BodyModel, *, mass: float | None = None) -> GroundForces:
    """Estimate ground reaction forces of both feet, whose sum is F = M (a + g) of the body.

    Segments have de Leva's masses. Accelerations are second differences over 1/20 s, which pass
    6.4 Hz at -3 dB: impacts of heels are smoothed away. Where both feet stand, they share the
    vertical force by the lever rule, so that it acts at the zero-moment point (Dijkstra and
    Gutierrez-Farewik, J Biomech 2015). Horizontal forces point from the centre of pressure to the
    centre of mass; what is missing to M a is shared like the weight. The centre of pressure is
    that of the lowest points of the sole, moved towards the zero-moment point where a foot stands
    alone, by inverse variances. The moment about the vertical is left out. The first and last
    1/20 s repeat their neighbours. Standard deviations grow with the distance of both points, the
    misfit: it tells how well the motion of this clip obeys Newton.

    Args:
        file: contents of a motion file. Its ground is z = 0 if it tells none; standard deviations
            of its joints, where it has them, widen those of the forces.
        body: whose motion it is.
        mass: kg; None takes that of the shape, whose standard deviation is a tenth of it.

    Raises:
        ReconError: when the clip is shorter than a tenth of a second, its ground is not level, or
            nobody has such a mass.
    """
    from scipy.ndimage import maximum_filter1d

    motion = file.motion
    step = difference_step(motion.fps)
    if motion.frames <= 2 * step:
        raise ReconError(
            f"forces need accelerations, and so {2 * step + 1} frames or more at {motion.fps:g} "
            f"Hz; the motion has {motion.frames}"
        )
    body = body.to(device="cpu", dtype=torch.float64)
    here = motion.detach().to(device="cpu", dtype=torch.float64)
    down = here.translation.new_tensor([0.0, 0.0, _level_of_ground(file)])
    posed = body.pose(here.replace(translation=here.translation - down))
    if mass is not None:
        MASS.check(mass, "mass")
    total = float(body_weight(body, here.shape)) if mass is None else float(mass)
    notes = (
        f"mass {total:.1f} kg: {'that of the shape' if mass is None else 'given'}",
        f"accelerations low-passed at {0.319 * motion.fps / step:.1f} Hz (-3 dB)",
        "both feet on the ground: shared by the lever rule about the zero-moment point",
    )
    moving = body_dynamics(posed, total * vertex_masses_of_segments(body), motion.fps)
    soles = Soles.of(body)
    points = posed.points(soles.points.flatten()).unflatten(-2, soles.points.shape)
    centre = centre_of_pressure(points, points.new_ones(points.shape[-2]), SOLE_DECAY)
    contact = standing_feet(points, motion.fps)
    target, load = (repeat_ends(one, step) for one in (zmp(moving), relative_load(moving)))
    share = _load_shares(centre, contact, target)
    away = ((share[..., None] * centre).sum(-2) - target).norm(dim=-1)
    carried = contact.any(-1) & ((away < OUT_OF_REACH_M) | (load < FULL_LOAD))
    alone = carried & (contact.sum(-1) == 1)
    misfit = float(away[alone].median()) if bool(alone.any()) else USUAL_MISFIT_M
    trusted = alone[:, None] & contact
    centre = _pressure_centres(centre, points[..., :2], target, trusted, misfit)
    centre = _smoothed_within_stances(centre, contact, motion.fps)
    # second differences in time spread the load of a push-off into frames of the flight after it
    explained = maximum_filter1d((carried | (load < FULL_LOAD)).numpy(), 4 * step + 1)
    warnings = _support_warnings(explained, contact)
    if mass is None:
        said = f"no mass given: forces are for {total:.1f} kg, that of the body's shape"
        warnings = [said, *warnings]
    contact = contact & carried[:, None]
    std = torch.zeros(motion.frames, 22) if file.joint_std is None else file.joint_std.cpu()
    place = math.hypot(CENTRE_STD_M, CENTRE_MISFIT * misfit)
    apart = (centre[:, 1] - centre[:, 0]).norm(dim=-1)
    shares = _force_std(contact, misfit, apart, motion.fps)
    drift = std.double().mean(-1)[:, None, None] / DRIFT_S**2 / GRAVITY
    unsure = (drift.square() + (SHAPE_MASS_SHARE * (mass is None)) ** 2) * contact[..., None]
    return GroundForces(
        force=_forces_by_foot(moving, centre, share * carried[:, None], step),
        centre=torch.nn.functional.pad(centre, (0, 1)) + down,
        force_std=total * GRAVITY * (shares.square() + unsure).sqrt(),
        centre_std=(std.double()[:, list(FEET[:2])].square() + place**2).sqrt(),
        contact=contact,
        mass=total,
        notes=notes,
        warnings=tuple(warnings),
    )


def standing_feet(points: Float[Tensor, "time 2 points 3"], fps: float) -> Bool[Tensor, "time 2"]:
    """Return a mask of feet that stand: a sole point is low and slow, for 0.08 s or longer."""
    from scipy.ndimage import median_filter

    speed = torch.gradient(points, spacing=1 / fps, dim=0)[0].norm(dim=-1)
    rests = ((points[..., 2] < CONTACT_HEIGHT_M) & (speed < CONTACT_SPEED_M_S)).any(-1)
    width = 2 * round(SHORTEST_S / 2 * fps) + 1
    kept = median_filter(rests.numpy().astype(np.uint8), size=(width, 1), mode="nearest")
    return torch.from_numpy(kept > 0)


def _level_of_ground(file: MotionFile) -> float:
    """Return the height of the level ground in a motion file, metres (0 if it has none).

    Raises:
        ReconError: when it is tilted.
    """
    if file.ground is None:
        return 0.0
    if float(file.ground[:2].norm()) > LEVEL * float(file.ground[2]):
        raise ReconError(
            "forces need level ground, but this file's is tilted: convert the recording again "
            "without --keep-frame, to level it"
        )
    return float(file.ground[3] / file.ground[2])


def _load_shares(centre: Tensor, contact: Tensor, target: Tensor) -> Float[Tensor, "time 2"]:
    """Return each foot's share of the vertical force: 0 or 1, or by the lever rule about ZMP."""
    line = centre[:, 1] - centre[:, 0]
    along = ((target - centre[:, 0]) * line).sum(-1) / line.square().sum(-1).clamp(min=1e-6)
    right = along.clamp(0, 1)
    both = contact.all(-1, keepdim=True)
    return torch.where(both, torch.stack((1 - right, right), -1), contact.to(centre))


def _forces_by_foot(
    moving: Dynamics, centre: Tensor, share: Tensor, step: int
) -> Float[Tensor, "time 2 3"]:
    """Split the total force between the feet: vertical by share, horizontal to the mass centre."""
    acceleration, mass_centre = (
        repeat_ends(moving.acceleration, step),
        repeat_ends(moving.centre, step),
    )
    inertia = moving.mass * acceleration
    up = share * (inertia[:, 2] + moving.mass * GRAVITY).clamp(min=0)[:, None]
    height = mass_centre[:, None, 2:].clamp(min=LEAST_HEIGHT_M)
    aimed = up[..., None] * (mass_centre[:, None, :2] - centre) / height
    rest = inertia[:, :2] * share.sum(-1, keepdim=True) - aimed.sum(-2)
    return torch.cat((aimed + share[..., None] * rest[:, None], up[..., None]), -1)


def _pressure_centres(
    pressed: Tensor, points: Tensor, target: Tensor, trusted: Tensor, misfit: float
) -> Float[Tensor, "time 2 2"]:
    """Move the centres of pressure of a foot that stands alone towards the ZMP, in the sole.

    The weights are inverse variances; the two variances add up to the square of the misfit.
    """
    inside = target[:, None].maximum(points.amin(-2)).minimum(points.amax(-2))
    weight = min(0.5, (PRESSED_STD_M / max(misfit, 1e-6)) ** 2)
    return pressed.lerp(inside, weight * trusted[..., None].to(pressed))


def _smoothed_within_stances(
    centre: Float[Tensor, "time 2 2"], contact: Bool[Tensor, "time 2"], fps: float
) -> Float[Tensor, "time 2 2"]:
    """Smooth each foot's centre of pressure over time, separately within every stance."""
    from scipy.ndimage import gaussian_filter1d

    found = centre.numpy().copy()
    for side in range(2):
        for first, stop in runs_of_true(contact[:, side].numpy()):
            stance = found[first:stop, side]
            found[first:stop, side] = gaussian_filter1d(stance, SMOOTH_S * fps, axis=0)
    return torch.from_numpy(found)


def _force_std(
    contact: Bool[Tensor, "time 2"], misfit: float, apart: Float[Tensor, " time"], fps: float
) -> Float[Tensor, "time 2 3"]:
    """Return standard deviations of the feet's forces, as shares of the body's weight.

    In double support the error of the shares comes from the zero-moment point (misfit over the
    distance of the feet) and from the time of the step (over the time of double support).
    """
    found = contact.new_zeros(*contact.shape, 3, dtype=torch.float64)
    across = [math.hypot(one, TILT_STD * misfit) for one in ACROSS_STD]
    found[..., :2], found[..., 2] = across[0], VERTICAL_STD
    found = found * contact[..., None]
    margin = round(STEP_S * fps)
    for first, stop in runs_of_true(contact.all(-1).numpy()):
        lever = LEVER_SHARE * misfit / float(apart[first:stop].median().clamp(min=0.05))
        share = math.hypot(min(0.5, lever), TIMING_STD_S * fps / (stop - first))
        near = slice(max(0, first - margin), stop + margin)
        found[near, :, :2] = across[1]
        found[near, :, 2] = math.hypot(VERTICAL_STD, min(0.5, share))
    return found


def repeat_ends(values: Tensor, step: int) -> Tensor:
    """Repeat the first and the last row `step` times, to extend inner frames to all frames."""
    ends = [values[:1].expand(step, *values.shape[1:]), values]
    return torch.cat((*ends, values[-1:].expand(step, *values.shape[1:])))


def _support_warnings(explained: Bool[np.ndarray, " time"], contact: Tensor) -> list[str]:
    """Return warnings about frames in which something else than the feet carries the body."""
    if not bool(contact.any()):
        return ["no foot ever stands on the ground: there is no contact, and all forces are zero"]
    if explained.all():
        return []
    share = 100 * float((~explained).mean())
    return [
        f"in {share:.0f} % of the frames something else than the feet carries the body (hands, "
        "the back, a chair, ground of another height): forces are zero there"
    ]
