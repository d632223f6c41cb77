"""Writes ground reaction forces and joint moments for OpenSim (.mot, .sto) or as CSV."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.body.opensim import OpenSimModel
from recon.core.motion import Motion, MotionFile
from recon.core.units import to_z_up
from recon.export.tables import write_storage
from recon.mocap.force_plates import read_force_plates
from recon.physics.forces import GroundForces, ground_forces
from recon.physics.moments import joint_moments
from recon.physics.plates import MeasuredForces, forces_under_feet


@dataclass(frozen=True)
class GroundLoads:
    """Ground reaction forces that were estimated, and those that force plates measured."""

    estimated: GroundForces
    measured: MeasuredForces | None
    decisions: tuple[str, ...]
    """What was assumed when the plates were read, in sentences."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the estimated and the measured forces."""
        return (*self.estimated.warnings, *(self.measured.warnings if self.measured else ()))

    def tables(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Compare estimated with measured forces, per foot; empty without plates."""
        return {"beside plates": self.measured.errors_of(self.estimated)} if self.measured else {}

    def report(self) -> dict[str, Any]:
        """Return the entries about forces in the report of a written file."""
        decisions = (*self.estimated.notes, *self.decisions)
        return {"decisions": decisions, "warnings": self.warnings, **self.tables()}


def ground_loads(
    file: MotionFile, body: BodyModel, mass: float | None, plates: Path | None
) -> GroundLoads:
    """Estimate ground reaction forces of a motion, and read those of plates in its C3D file.

    Raises:
        ValueError: when forces cannot be estimated or read; the message says why.
    """
    found = ground_forces(file, body, mass=mass)
    if plates is None:
        return GroundLoads(found, None, ())
    read = read_force_plates(plates)
    return GroundLoads(found, forces_under_feet(read, found, file.motion), read.decisions)


def write_forces(path: Path, motion: Motion, loads: GroundLoads) -> None:
    """Write ground reaction forces, a row per frame, right foot first; N, m, N m, y up.

    `ground_force_r_vx` is the force on the right foot, `ground_force_r_px` its centre of pressure,
    `ground_torque_r_x` the moment about it (zero). `std_force_r_x` and `std_centre_r` are standard
    deviations, named so that OpenSim does not take them for external loads.
    With plates there are `plate_force_r_x`, `plate_centre_r_x` and `plate_known_r` (0 or 1), too.
    """
    forces, plates = loads.estimated, loads.measured
    columns: dict[str, Float[np.ndarray, " time"]] = {}
    for end, side in (("r", 1), ("l", 0)):
        columns |= _columns_by_axis(f"ground_force_{end}_v", forces.force[:, side])
        columns |= _columns_by_axis(f"ground_force_{end}_p", forces.centre[:, side])
    for end in "rl":
        columns |= {f"ground_torque_{end}_{axis}": np.zeros(motion.frames) for axis in "xyz"}
    for end, side in (("r", 1), ("l", 0)):
        widths = _columns_by_axis(f"std_force_{end}_", forces.force_std[:, side])
        columns |= {name: np.abs(values) for name, values in widths.items()}
        columns[f"std_centre_{end}"] = forces.centre_std[:, side].numpy()
        if plates is not None:
            columns |= _columns_by_axis(
                f"plate_force_{end}_", torch.from_numpy(plates.force[:, side])
            )
            columns |= _columns_by_axis(
                f"plate_centre_{end}_", torch.from_numpy(plates.centre[:, side])
            )
            columns[f"plate_known_{end}"] = plates.known[:, side].astype(float)
    write_storage(path, "Ground reaction forces", motion, columns)


def write_moments(
    path: Path, motion: Motion, body: BodyModel, loads: GroundLoads, model: OpenSimModel
) -> None:
    """Write moments of the leg joints, N m, with the names of OpenSim's inverse dynamics.

    The standard deviation of `hip_flexion_r_moment` is `hip_flexion_r_std`; `plate_known_r` is 1
    where a plate measured the force on that foot, and 0 where it is estimated.
    """
    found = joint_moments(motion, body, loads.estimated, loads.measured, model)
    columns = {f"{name}_moment": values for name, values in found.moments.items()}
    columns |= {f"{name}_std": values for name, values in found.std.items()}
    columns |= {
        f"plate_known_{end}": found.measured[:, k] * 1.0 for k, end in ((1, "r"), (0, "l"))
    }
    write_storage(path, "Inverse Dynamics Generalized Forces", motion, columns)


def _columns_by_axis(name: str, vectors: Tensor) -> dict[str, Float[np.ndarray, " time"]]:
    """Rotate vectors (time, 3) to y up; return their coordinates, keyed by name and axis."""
    y_up = vectors.double().cpu().numpy() @ to_z_up("y")
    return {f"{name}{axis}": y_up[:, k] for k, axis in enumerate("xyz")}
