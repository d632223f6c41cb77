"""Assigns the forces that force plates measured to the feet that stood on them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from recon.body.parts import GRAVITY
from recon.core.arrays import runs_of_true
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.mocap.force_plates import ForcePlates
from recon.physics.forces import GroundForces

NEAR_M = 0.2
"""Median distance of measured from estimated centres of pressure that are one foot's, at most."""
SHARED = 0.2
"""Share of the frames in which two feet on one plate make it useless."""
PRESSED = 0.1
"""Share of the weight from which on centres of pressure are compared."""


@dataclass(frozen=True)
class MeasuredForces:
    """Forces that force plates measured under each foot, resampled at a motion's frames."""

    force: Float[np.ndarray, "time 2 3"]
    """On the person, newtons; zero where it is not known."""
    centre: Float[np.ndarray, "time 2 3"]
    """Centre of pressure, metres; zero where it is not known."""
    torque: Float[np.ndarray, "time 2"]
    """Moment about the vertical, newton metres."""
    known: Bool[np.ndarray, "time 2"]
    """Whether the foot was alone on a plate."""
    warnings: tuple[str, ...]

    def errors_of(self, found: GroundForces) -> dict[str, dict[str, Any]]:
        """Return the errors of estimated forces against the measured ones, by foot.

        Root mean square of the vertical force in % of the weight, error of its impulse in %, and
        mean distance of the centres of pressure in cm where a tenth of the weight presses.
        """
        weight = found.mass * GRAVITY
        table: dict[str, dict[str, Any]] = {}
        for side, name in enumerate(("left", "right")):
            known = self.known[:, side]
            if not known.any():
                continue
            measured = self.force[known, side, 2]
            away = found.force[:, side, 2].numpy()[known] - measured
            apart = (found.centre[:, side].numpy() - self.centre[:, side])[known, :2]
            pressed = measured > PRESSED * weight
            table[name] = {
                "frames": int(known.sum()),
                "vertical_rms_percent": float(100 * np.sqrt(np.mean(away**2)) / weight),
                "impulse_percent": float(100 * away.sum() / measured.sum()),
                "centre_cm": float(100 * np.linalg.norm(apart[pressed], axis=-1).mean()),
            }
        return table


def forces_under_feet(plates: ForcePlates, found: GroundForces, motion: Motion) -> MeasuredForces:
    """Assign plate forces to the feet, resampled at the frames of the recording's motion.

    Every stretch in which a plate is loaded belongs to the foot whose estimated centre of pressure
    is nearest. A plate under both feet is left out.

    Args:
        plates: in the motion's world but for its height, on the motion's clock.
        found: estimated forces of the motion.
        motion: one clip.

    Raises:
        ReconError: when no loaded plate is below a foot: those of another trial, or other axes.
    """
    times = motion.times.double().cpu().numpy()
    clock = plates.start_time + np.arange(len(plates.force)) / plates.fps
    if clock[-1] < times[0] or clock[0] > times[-1]:
        raise ReconError(
            f"the plates were recorded from {clock[0]:.2f} to {clock[-1]:.2f} s, the motion from "
            f"{times[0]:.2f} to {times[-1]:.2f} s: give the file that the motion was made from"
        )
    at = np.clip(np.round((times - clock[0]) * plates.fps).astype(int), 0, len(clock) - 1)
    there = (times >= clock[0] - 0.5 / plates.fps) & (times <= clock[-1] + 0.5 / plates.fps)
    centre, contact = found.centre.numpy()[..., :2], found.contact.numpy()
    force, place = np.zeros((len(times), 2, 3)), np.zeros((len(times), 2, 3))
    torque, known = np.zeros((len(times), 2)), np.zeros((len(times), 2), dtype=bool)
    nearest, shared, strange = np.inf, 0, 0
    for k in range(plates.force.shape[1]):
        for first, stop in runs_of_true(plates.loaded[at, k] & there):
            frames, rows = np.arange(first, stop), at[first:stop]
            pressed = plates.centre[rows, k, None, :2]
            apart = np.median(np.linalg.norm(pressed - centre[frames], axis=-1), axis=0)
            side = int(apart.argmin())
            nearest = min(nearest, float(apart[side]))
            if apart[side] > NEAR_M:
                strange += 1
                continue
            if _stands_within(
                plates.corners[k], centre[frames, 1 - side], contact[frames, 1 - side]
            ):
                shared += 1
                continue
            load = plates.force[rows, k, 2:]
            before = force[frames, side, 2:]
            whole = np.maximum(load + before, 1e-9)
            place[frames, side] = (
                before * place[frames, side] + load * plates.centre[rows, k]
            ) / whole
            force[frames, side] += plates.force[rows, k]
            torque[frames, side] += plates.torque[rows, k]
            known[frames, side] = True
    warnings: list[str] = []
    if np.isfinite(nearest) and nearest > NEAR_M:
        raise ReconError(
            f"the plates' centres of pressure are {nearest:.2f} m or more from the feet: they are "
            "of another trial, or the motion was turned since: convert it with --keep-frame"
        )
    if strange:
        warnings.append(f"{strange} loads on a plate with no foot on it were left out")
    if shared:
        warnings.append(
            f"{shared} times both feet stood on one plate: its forces were left out there"
        )
    if not known.any():
        warnings.append("no foot stood alone on a plate: there is nothing to compare")
    place[..., 2] = found.centre.numpy()[..., 2]
    return MeasuredForces(force, place, torque, known, tuple(warnings))


def _stands_within(corners: np.ndarray, centre: np.ndarray, contact: np.ndarray) -> bool:
    """Whether a foot in contact is in a plate's rectangle in over a fifth of the frames."""
    origin, sides = corners[0, :2], (corners[[1, 3]] - corners[0])[:, :2]
    along = (centre - origin) @ sides.T / (sides**2).sum(-1)
    inside = ((along > 0) & (along < 1)).all(-1) & contact
    return bool(inside.mean() > SHARED)
