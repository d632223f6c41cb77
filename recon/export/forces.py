"""Writes forces of the ground as OpenSim's external loads (.mot, .sto) or CSV."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.units import to_z_up
from recon.export.tables import write_storage
from recon.physics.forces import GroundForces

ENDINGS = (".mot", ".sto", ".csv")


def check_ending(option: str, path: Path | None) -> None:
    """Refuse a file of another kind than OpenSim's storage or CSV.

    Raises:
        ReconError: naming the option.
    """
    if path is not None and path.suffix.lower() not in ENDINGS:
        raise ReconError(f"--{option} {path}: expected a file that ends in {', '.join(ENDINGS)}")


def write_forces(path: Path, motion: Motion, forces: GroundForces) -> None:
    """Write a row per frame, right foot first; newtons, metres, newton metres, y up.

    `ground_force_r_vx` is the force on the right foot, `ground_force_r_px` its centre of pressure,
    `ground_torque_r_x` the moment about it (zero). `std_force_r_x` and `std_centre_r` are standard
    deviations; no name of theirs begins as the identifiers of OpenSim's external loads do.
    """
    columns: dict[str, Float[np.ndarray, " time"]] = {}
    for end, side in (("r", 1), ("l", 0)):
        columns |= _axes(f"ground_force_{end}_v", forces.force[:, side])
        columns |= _axes(f"ground_force_{end}_p", forces.centre[:, side])
    for end in "rl":
        columns |= {f"ground_torque_{end}_{axis}": np.zeros(motion.frames) for axis in "xyz"}
    for end, side in (("r", 1), ("l", 0)):
        widths = _axes(f"std_force_{end}_", forces.force_std[:, side])
        columns |= {name: np.abs(values) for name, values in widths.items()}
        columns[f"std_centre_{end}"] = forces.centre_std[:, side].numpy()
    write_storage(path, "Ground reaction forces", motion, columns)


def _axes(name: str, vectors: Tensor) -> dict[str, Float[np.ndarray, " time"]]:
    """Coordinates of vectors (time 3) with y up, by name and axis."""
    turned = vectors.double().cpu().numpy() @ to_z_up("y")
    return {f"{name}{axis}": turned[:, k] for k, axis in enumerate("xyz")}
