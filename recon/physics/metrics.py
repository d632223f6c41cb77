"""Metrics of physics: HUMOS's five as its code computes them, and corrected ones.

Rates other than 20 Hz keep the meaning of every threshold; published numbers are at 20 Hz.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.body.parts import Parts, centre_of_mass
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.core.struct import TensorStruct, concatenate
from recon.metrics import errors as metrics
from recon.physics.dynamics import (
    SPAN,
    Dynamics,
    body_dynamics,
    difference_step,
    vertex_masses,
    vertex_masses_as_published,
)
from recon.physics.energies import TOLERANCE
from recon.physics.zmp import (
    can_carry_weight,
    distances_to_support,
    share_carried,
    zmp,
    zmp_of_humos_code,
)

JOINT_CONTACT = 0.015
"""Metres below which a foot joint is in contact (HUMOS): SMPL's toe joints sink as deep only
when the foot does."""

SOLE_CONTACT = 0.015
"""Metres below which the lowest point of a foot is in contact."""

NO_GROUND = 0.05
"""Metres above which the body's lowest point has left the ground."""

_SIDES = ((7, 10), (8, 11))
_CHUNK_FRAMES = 64
"""Frames whose surface is computed at once, to bound memory."""


@dataclass(frozen=True)
class PhysicsSamples(TensorStruct):
    """Per-frame measurements of contact and balance, from which metrics are averaged."""

    lowest: Float[Tensor, " frames"]
    """Height of the lowest vertex, metres."""
    stepped: Bool[Tensor, " frames"]
    """Whether there is a next frame."""
    joints_touch: Bool[Tensor, "frames 4"]
    """Ankles and toes that are lower than 1.5 cm in this frame and the next, but moved between."""
    sunk_step: Float[Tensor, " frames"]
    """Mean horizontal step of vertices at or below the ground in both frames, m per 1/20 s."""
    soles_touch: Bool[Tensor, "frames 2"]
    """Feet in contact in this frame and the next."""
    slip: Float[Tensor, "frames 2"]
    """Horizontal speed of the lowest vertex of each foot, m/s."""
    has_base: Bool[Tensor, " frames"]
    released_distance: Float[Tensor, " frames"]
    """Distance of the released ZMP from the base of support, negative inside, metres."""
    distance: Float[Tensor, " frames"]
    """Distance of the ZMP from the base of support, negative inside, metres."""
    known: Bool[Tensor, " frames"]
    """Frames with a ZMP of their own: not the first and the last."""
    carried: Bool[Tensor, " frames"]
    """The ground carries a fifth of the weight or more, and is within 5 cm."""


def physics_samples(
    motion: Motion, body: BodyModel, contacts: Bool[Tensor, "time 2"] | None = None
) -> PhysicsSamples:
    """Measure contact, slip and balance in every frame of one clip.

    Args:
        motion: One clip; the ground is z = 0.
        body: Of any shape space; the motion has its shape.
        contacts: Of the left and right foot where they are known, as those of the clip that this
            one was retargeted from; else feet whose lowest point is under 1.5 cm.

    Raises:
        ValueError: when the motion is a batch or too short for accelerations, or the contacts
            are those of other frames.
    """
    if motion.translation.dim() != 2:
        raise ValueError(
            f"expected one clip, got a batch of shape {tuple(motion.translation.shape[:-2])}; "
            "measure its clips one by one"
        )
    if contacts is not None and contacts.shape != (motion.frames, 2):
        raise ValueError(
            f"expected contacts of two feet in {motion.frames} frames, got an array of shape "
            f"{tuple(contacts.shape)}; resample the labels to the motion's frames first"
        )
    motion = motion.window(0, int(motion.valid.long().cumprod(0).sum()))
    step = difference_step(motion.fps)
    if motion.frames < 2 * step + 1:
        raise ValueError(
            f"accelerations need {2 * step + 1} frames at {motion.fps:g} frames per second, got "
            f"{motion.frames}; give a longer clip"
        )
    body = body.to(device=motion.translation.device, dtype=torch.float64)
    motion = motion.to(dtype=torch.float64)
    points, carrying = _zero_moment_points(motion, body)
    pieces = []
    for start in range(0, motion.frames, _CHUNK_FRAMES):
        stop = min(start + _CHUNK_FRAMES, motion.frames)
        held = None if contacts is None else contacts[start : stop + 1]
        # speeds are steps to the next frame; the last frame takes the step before it
        pieces.append(
            _surface_samples(
                motion, body, max(start - 1, 0), start, stop, held, points[start:stop]
            )
        )
    samples = concatenate(pieces)
    frame = torch.arange(motion.frames, device=samples.lowest.device)
    return samples.replace(
        known=(frame >= step) & (frame < motion.frames - step),
        carried=carrying & (samples.lowest < NO_GROUND),
    )


def _zero_moment_points(motion: Motion, body: BodyModel) -> tuple[Tensor, Tensor]:
    """Return the ZMP by HUMOS's code and the corrected one, and a mask of supported frames.

    The first and last frames take their neighbour's acceleration and spin (released code).
    """
    posed = body.pose(motion)
    first = body.pose(motion.window(0, 1)).vertices[0]
    masses = (
        vertex_masses_as_published(first, Parts.of(body)),
        vertex_masses(body, motion.shape),
    )
    step = difference_step(motion.fps)
    last = motion.frames - 2 * step - 1
    nearest = (torch.arange(motion.frames, device=first.device) - step).clamp(0, last)
    old, new = (
        Dynamics(
            found.mass,
            centre_of_mass(posed, mass),
            found.acceleration[nearest],
            found.spin[nearest],
        )
        for mass in masses
        for found in (body_dynamics(posed, mass, motion.fps),)
    )
    return torch.stack((zmp_of_humos_code(old), zmp(new)), -2), share_carried(new) >= 0.5


def _surface_samples(
    motion: Motion,
    body: BodyModel,
    before: int,
    start: int,
    stop: int,
    contacts: Tensor | None,
    points: Tensor,
) -> PhysicsSamples:
    """Measure frames start, ..., stop - 1; those from `before` on serve to compute speeds."""
    posed = body.pose(motion.window(before, min(stop + 1, motion.frames)))
    skin, own = posed.vertices, slice(start - before, stop - before)
    step_exists = torch.arange(start, stop, device=skin.device) + 1 < motion.frames
    # the last frame, which no frame follows, is compared with itself; `step_exists` leaves it out
    following = torch.arange(own.start + 1, own.stop + 1).clamp(max=len(skin) - 1)
    steps = (skin[following, :, :2] - skin[own, :, :2]).norm(dim=-1)
    sunk = (skin[own, :, 2] <= 0) & (skin[following, :, 2] <= 0)
    feet = posed.joints[:, list(FEET)]
    low = feet[..., 2] < JOINT_CONTACT
    moved = (feet[following, :, :2] != feet[own, :, :2]).any(-1)
    touch, slip = _slip_of_feet(body, skin, own, following, steps, motion.fps)
    if contacts is not None:
        after = torch.arange(1, stop - start + 1).clamp(max=len(contacts) - 1)
        touch = contacts[: stop - start] & contacts[after]
    distances, has_base = distances_to_support(
        points, skin[own], can_carry_weight(skin, motion.fps)[own]
    )
    return PhysicsSamples(
        lowest=skin[own, :, 2].amin(-1),
        stepped=step_exists,
        joints_touch=low[own] & low[following] & moved & step_exists[:, None],
        sunk_step=(steps * sunk).sum(-1) / sunk.sum(-1).clamp(min=1) * motion.fps * SPAN,
        soles_touch=touch & step_exists[:, None],
        slip=slip,
        has_base=has_base,
        released_distance=distances[:, 0],
        distance=distances[:, 1],
        known=step_exists,
        carried=step_exists,
    )


def _slip_of_feet(
    body: BodyModel, skin: Tensor, own: slice, following: Tensor, steps: Tensor, fps: float
):
    """Return a mask of feet on the ground, and the speed (m/s) of each lowest foot vertex."""
    owner = body.weights.argmax(-1)
    touch, slip = [], []
    for side in _SIDES:
        foot = torch.isin(owner, owner.new_tensor(side)).nonzero()[:, 0]
        height, lowest = skin[own][:, foot, 2].min(-1)
        later = skin[following][:, foot, 2].gather(-1, lowest[:, None])[:, 0]
        touch.append((height < SOLE_CONTACT) & (later < SOLE_CONTACT))
        slip.append(steps[:, foot].gather(-1, lowest[:, None])[:, 0] * fps)
    return torch.stack(touch, -1), torch.stack(slip, -1)


SLIPPING = 0.1
"""m/s from which a foot in contact slips."""


def physics_metrics(samples: PhysicsSamples) -> dict[str, float | None]:
    """Average samples to all physics metrics, SI units; None without samples (docs/physics.md)."""
    return {
        **humos_metrics(samples),
        **physdiff_metrics(samples),
        **balance_metrics(samples),
        **slip_metrics(samples),
    }


def humos_metrics(samples: PhysicsSamples) -> dict[str, float | None]:
    """The metrics of HUMOS's table as its released code computes them.

    `penetrate` and `float` are means over the frames that do so by more than 5 mm, 0 where none
    does. `skate` is the share of ankles and toes under 1.5 cm, whatever their speed.
    `dynamic_stability` is the share of frames whose released ZMP is inside the base of support;
    without a base it is not. `bos_distance` is the mean over the frames outside of one.
    """
    depth, unstable = -samples.lowest, samples.has_base & (samples.released_distance > 0)
    stable = samples.has_base & (samples.released_distance < 0)
    return {
        "penetrate": metrics.mean(depth, depth > TOLERANCE) or 0.0,
        "float": metrics.mean(-depth, -depth >= TOLERANCE) or 0.0,
        "skate": metrics.mean(samples.joints_touch.double()[samples.stepped]),
        "dynamic_stability": metrics.mean(stable.double()),
        "bos_distance": metrics.mean(samples.released_distance, unstable),
    }


def physdiff_metrics(samples: PhysicsSamples) -> dict[str, float | None]:
    """PhysDiff's penetration, float and skate of vertices, and their sum, metres.

    Means over all frames, those without an error counting as zero; skate per 1/20 s.
    """
    depth = -samples.lowest
    sunk = metrics.mean(depth.where(depth > TOLERANCE, 0.0))
    afloat = metrics.mean((-depth).where(-depth > TOLERANCE, 0.0))
    skate = metrics.mean(samples.sunk_step, samples.stepped)
    whole = None if sunk is None or afloat is None or skate is None else sunk + afloat + skate
    return {
        "physdiff_penetrate": sunk,
        "physdiff_float": afloat,
        "physdiff_skate": skate,
        "physdiff_error": whole,
    }


def balance_metrics(samples: PhysicsSamples) -> dict[str, float | None]:
    """Shares of supported and of flying frames whose ZMP lies in the base of support."""
    stable = (samples.has_base & (samples.distance < 0)).double()
    carried, flying = samples.known & samples.carried, samples.known & ~samples.carried
    unstable = carried & samples.has_base & (samples.distance > 0)
    return {
        "stability_supported": metrics.mean(stable, carried),
        "stability_flight": metrics.mean(stable, flying),
        "bos_distance_supported": metrics.mean(samples.distance, unstable),
        "flight": metrics.mean(flying.double(), samples.known),
    }


def slip_metrics(samples: PhysicsSamples) -> dict[str, float | None]:
    """Mean horizontal speed of the lowest points of feet in contact, and share above 0.1 m/s."""
    return {
        "slip_in_contact": metrics.mean(samples.slip, samples.soles_touch),
        "slipping": metrics.mean((samples.slip > SLIPPING).double(), samples.soles_touch),
    }
