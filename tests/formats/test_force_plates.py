"""Force plates of C3D files: all types tell the same of one load; real files as ezc3d has them."""

import os
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from recon.core.errors import FormatError
from recon.mocap.force_plates import read_force_plates

DATA = os.environ.get("RECON_DATA")
FORCE = np.array([12.0, -30.0, 640.0])
PLACE = np.array([0.08, -0.05, 0.0])
"""Centre of pressure from the middle of the plate."""
TWIST = np.array([0.0, 0.0, 3.0])
ORIGIN = np.array([0.0, 0.0, -0.04])
CORNERS = np.array([[0.4, 0.1, 0.0], [0.0, 0.1, 0.0], [0.0, 0.7, 0.0], [0.4, 0.7, 0.0]])
AXES = np.diag([1.0, -1.0, -1.0])
"""Of a plate with these corners: z points down."""
RATE, SAMPLES, FRAMES = 100.0, 10, 30


def channels(kind: int) -> np.ndarray:
    """Numbers of the channels of a plate of a type under this load, N and m."""
    force = AXES.T @ FORCE
    moment = AXES.T @ (np.cross(PLACE, FORCE) + TWIST)
    if kind == 1:
        return np.array([*force, *(AXES.T @ PLACE)[:2], (AXES.T @ TWIST)[2]])
    below = moment - np.cross(force, ORIGIN)
    if kind in (2, 4):
        return np.array([*force, *below])
    a, b = 0.12, 0.2
    upright = np.array([[1, 1, 1, 1], [b, b, -b, -b], [-a, a, a, -a]])
    flat = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [-b, b, a, -a]])
    z = np.linalg.pinv(upright) @ [force[2], below[0], below[1]]
    return np.array([*(np.linalg.pinv(flat) @ [force[0], force[1], below[2]]), *z])


def write_plate(path: Path, kind: int, *, moments: float = 1000.0, unit="Nmm", **more) -> Path:
    """A file in mm of one plate that is loaded from frame 10 on, with an offset of 5 N in x."""
    numbers = channels(kind)
    if kind == 1:
        numbers[3:5] *= 1000
        numbers[5] *= moments
    elif kind in (2, 4):
        numbers[3:] *= moments
    matrix = np.eye(6) + 0.1 * np.arange(36).reshape(6, 6) / 36
    if kind == 4:
        numbers = np.linalg.solve(matrix, numbers)
    values = np.zeros((1, len(numbers), FRAMES * SAMPLES))
    values[0, :, 10 * SAMPLES :] = numbers[:, None] * more.get("sign", 1.0)
    values[0, 0] += 5
    if kind == 1:
        values[0, 3:5, : 10 * SAMPLES] = more.get("centre", 0.0)
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    c3d["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = ["A"]
    c3d["parameters"]["ANALOG"]["RATE"]["value"] = [RATE * SAMPLES]
    c3d["parameters"]["ANALOG"]["LABELS"]["value"] = [f"c{k}" for k in range(len(numbers))]
    c3d["parameters"]["ANALOG"]["UNITS"]["value"] = ["N"] * (len(numbers) - 1) + [
        "N" if kind == 3 else unit
    ]
    origin = ORIGIN + np.array([0.12, 0.2, 0.0]) if kind == 3 else ORIGIN
    plate = {
        "USED": [1], "TYPE": [more.get("stated", kind)], "ZERO": [1, 50],
        "CORNERS": (1000 * more.get("corners", CORNERS)).T[:, :, None],
        "ORIGIN": 1000 * origin[:, None],
        "CHANNEL": np.arange(1.0, len(numbers) + 1)[:, None] + more.get("shift", 0),
        "CAL_MATRIX": matrix[:, :, None],
    }  # fmt: skip
    for key, value in plate.items():
        c3d.add_parameter("FORCE_PLATFORM", key, value)
    c3d["data"]["points"] = np.ones((4, 1, FRAMES))
    c3d["data"]["analogs"] = values
    c3d.write(str(path))
    return path


@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_every_type_tells_force_centre_and_twist(tmp_path: Path, kind: int) -> None:
    found = read_force_plates(write_plate(tmp_path / "one.c3d", kind))
    assert found.decisions == ()
    assert found.loaded[:, 0].tolist() == [k >= 10 for k in range(FRAMES)]
    late = slice(12, None)
    # the offset is removed where it is one of newtons: a matrix mixes it
    assert found.force[late, 0] == pytest.approx(np.tile(FORCE, (FRAMES - 12, 1)), abs=1e-3)
    assert found.centre[late, 0] == pytest.approx(
        np.tile(PLACE + CORNERS.mean(0), (FRAMES - 12, 1)), abs=1e-5
    )
    assert found.torque[late, 0] == pytest.approx(TWIST[2], abs=1e-3)
    assert not found.force[:9].any()
    assert not found.centre[:9].any()


def test_a_centre_of_pressure_that_is_stated_without_load_shifts_none(tmp_path: Path) -> None:
    found = read_force_plates(write_plate(tmp_path / "one.c3d", 1, centre=120.0))
    assert found.centre[-1, 0] == pytest.approx(PLACE + CORNERS.mean(0), abs=1e-5)


def test_moments_in_another_unit_and_forces_on_the_plate_are_put_right(tmp_path: Path) -> None:
    wrong_unit = read_force_plates(write_plate(tmp_path / "a.c3d", 2, unit="Nm"))
    assert wrong_unit.centre[-1, 0] == pytest.approx(PLACE + CORNERS.mean(0), abs=1e-5)
    assert "its moments are in N mm" in wrong_unit.decisions[0]
    turned = read_force_plates(write_plate(tmp_path / "b.c3d", 2, sign=-1.0))
    assert turned.force[-1, 0] == pytest.approx(FORCE, abs=1e-3)
    assert "turned into those on the person" in turned.decisions[0]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"stated": 7}, "expected a plate of type 1 to 4, got type 7"),
        ({"shift": 3}, "lacks the plate's channels"),
        ({"corners": np.ones((4, 3))}, "corners are no rectangle"),
        ({"moments": 1e7}, "centre of pressure lies beside the plate"),
    ],
)
def test_plates_that_cannot_be_read_are_named(tmp_path: Path, more, said: str) -> None:
    with pytest.raises(FormatError, match=said):
        read_force_plates(write_plate(tmp_path / "one.c3d", 2, **more))


@pytest.mark.skipif(DATA is None, reason="needs real recordings: RECON_DATA")
@pytest.mark.parametrize(
    "name",
    ["biomechzoo/HC030A05", "rehazenter/2014001_C1_01", "vendors/btk_ADemo1_rewrite_c3d_pc_float"],
)
def test_real_plates_are_as_ezc3d_has_them(name: str) -> None:
    path = Path(str(DATA)) / "observations" / f"{name}.c3d"
    found, theirs = read_force_plates(path), ezc3d.c3d(str(path), extract_forceplat_data=True)
    for k, plate in enumerate(theirs["data"]["platform"]):
        on = found.loaded[:, k] & (found.force[:, k, 2] > 200)
        samples = plate["force"].shape[1] // len(on)
        frames = plate["force"].T[::samples]
        assert np.abs(frames - found.force[:, k])[on].mean() < 3  # N, averages of a frame
        centre = plate["center_of_pressure"].T[::samples] / 1000
        assert np.abs(centre - found.centre[:, k])[on].mean() < 2e-3  # m


@pytest.mark.skipif(DATA is None, reason="needs real recordings: RECON_DATA")
def test_a_file_without_plates_is_refused() -> None:
    path = Path(str(DATA)) / "observations" / "pycgm" / "RoboStatic.c3d"
    with pytest.raises(FormatError, match="analog channels"):
        read_force_plates(path)
