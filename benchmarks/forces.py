"""Compares estimated ground forces with force plates, in walks of people who stepped on them.

    python -m benchmarks.forces OBSERVATIONS --out FOLDER

Markers are converted without the plates. For every foot that stood alone on a plate, there are the
errors of vertical force (root mean square, % of the weight), its impulse (%) and the centre of
pressure (cm, where it carries a tenth of the weight or more), and the share of true values within
the intervals of 90 %. Numbers of a person are means over the stances, the last row of a part is
the mean over people. `benchmarks/forces.toml` lists people on whom constants were chosen, and
people who were measured afterwards.
"""

import tomllib
from pathlib import Path

import numpy as np

import recon
from benchmarks.protocol import NINE_TENTHS, Cell, Table, number, parser, recordings_source, tell
from recon import BodyModel
from recon.mocap.force_plates import read_force_plates
from recon.physics.forces import GroundForces, ground_forces
from recon.physics.plates import PRESSED, MeasuredForces, forces_under_feet

LIST = Path(__file__).with_suffix(".toml")
COLUMNS: list[tuple[str, int | None]] = [
    ("person", None), ("stances", 0), ("vertical RMS %", 1), ("impulse %", 1), ("centre cm", 1),
    ("vertical in 90 %", 0), ("horizontal in 90 %", 0), ("centre in 90 %", 0),
]  # fmt: skip


def main() -> None:
    """Convert, estimate, compare, print and write."""
    given = parser(__doc__, "observations").parse_args()
    body, rows, read = BodyModel.load(), list[list[Cell]](), list[str]()
    for part, people in tomllib.loads(LIST.read_text(encoding="utf-8")).items():
        means: list[np.ndarray] = []
        for person, listed in people.items():
            read += listed["paths"]
            found = [
                stance
                for path in listed["paths"]
                for stance in stances(given.observations / path, listed["mass"], body)
            ]
            means.append(np.mean(found, axis=0))
            rows.append([f"{part}: {person}", len(found), *map(number, means[-1].tolist())])
        rows.append([f"{part}: mean", len(means), *map(number, np.mean(means, 0).tolist())])
    sources = recordings_source(given.observations, read)
    tell(given.out, None, sources, {"forces": Table(COLUMNS, rows)})


def stances(path: Path, mass: float, body: BodyModel) -> list[np.ndarray]:
    """Return the errors of every foot that stood alone on a plate, in the order of the columns."""
    file = recon.convert(path).file
    found = ground_forces(file, body, mass=mass)
    measured = forces_under_feet(read_force_plates(path), found, file.motion)
    sides = {"left": 0, "right": 1}
    return [
        np.array([
            row["vertical_rms_percent"], abs(row["impulse_percent"]), row["centre_cm"],
            *held(measured, found, sides[name]),
        ])
        for name, row in measured.errors_of(found).items()
    ]  # fmt: skip


def held(measured: MeasuredForces, found: GroundForces, side: int) -> tuple[float, float, float]:
    """Return percentages of values within 90 % intervals: vertical, horizontal, centre."""
    on = measured.known[:, side]
    away = np.abs(found.force.numpy() - measured.force)[on, side]
    inside = away < NINE_TENTHS * found.force_std.numpy()[on, side]
    pressed = measured.force[on, side, 2] > PRESSED * found.mass * 9.81
    apart = np.abs(found.centre.numpy() - measured.centre)[on, side, :2]
    centre = apart < NINE_TENTHS * found.centre_std.numpy()[on, side, None]
    shares = (inside[:, 2], inside[:, :2], centre[pressed])
    up, across, place = (100 * float(one.mean()) for one in shares)
    return up, across, place


if __name__ == "__main__":
    main()
