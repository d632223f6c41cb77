"""Reads analog channels and force plates of types 1 to 4 from C3D files; forces have z up."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from recon.core import units
from recon.core.errors import FormatError
from recon.core.units import Up, parse_unit
from recon.formats.texts import read_binary
from recon.mocap.c3d import Parameters, positive_number, read_head, read_numbers, texts
from recon.mocap.recording import stated_rate

LOADED_N = 20.0
"""Vertical force from which on a plate is loaded, newtons."""
BASELINE_N = 60.0
"""Force that an empty plate may show, at most; more is somebody who stands on it."""
BESIDE_M = 0.05
"""Metres beyond its edges in which the centre of pressure on a plate may be told."""
INSIDE = 0.8
"""Share of the loaded frames in which the centre of pressure must be on the plate."""
_MOMENT_UNITS = {1.0: "", 1e-3: "N mm", 1e3: "kN m"}
"""Units of moments by what they are multiplied by; the first one is as stated."""
_CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}
"""Number of channels of a plate by its type."""


@dataclass(frozen=True)
class AnalogChannels:
    """Analog channels of a C3D file in their units, and the groups of parameters about them."""

    values: Float[np.ndarray, "frames samples channels"]
    """Numbers after offset and scale; every frame of points has several samples."""
    fps: float
    """Frames per second."""
    start_time: float
    """Time of the first sample, seconds of the markers' clock."""
    groups: Mapping[str, Parameters]

    def numbers(self, group: str, key: str, *shape: int) -> np.ndarray:
        """Return a parameter's numbers in a given shape (C order); empty if it is missing."""
        value = self.groups.get(group, {}).get(key)
        size = math.prod(abs(one) for one in shape)
        if not isinstance(value, np.ndarray) or value.size % size:
            return np.zeros((0, *(max(0, one) for one in shape[1:])))
        return value.astype(np.float64).reshape(shape)

    def texts(self, group: str, key: str) -> tuple[str, ...]:
        """Return the texts of a C3D parameter."""
        return texts(self.groups.get(group, {}), key)


def read_analog(path: Path) -> AnalogChannels:
    """Read the analog channels of a .c3d file.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or has no analog channels.
    """
    data = read_binary(path)
    header, groups = read_head(data, path)
    analog = groups.get("ANALOG", {})
    if header.analog == 0 or header.analog_rows == 0:
        raise FormatError(f"{path}: expected a C3D file with analog channels, but it has none")
    integer = "u2" if "".join(texts(analog, "FORMAT")).upper() == "UNSIGNED" else "i2"
    after = slice(4 * header.points, None)
    raw = read_numbers(data, header, path, after, integer)
    values = raw.reshape(len(raw), header.analog_rows, -1)
    rate = positive_number(groups.get("POINT", {}), "RATE") or header.rate
    fps = stated_rate(rate, path, "rate")[0]
    first = max(1, header.first)
    made = AnalogChannels(values, fps, (first - 1) / fps, groups)
    channels = values.shape[-1]
    scale = np.ones(channels)
    offset = np.zeros(channels)
    for target, key in ((scale, "SCALE"), (offset, "OFFSET")):
        stated = made.numbers("ANALOG", key, -1)[:channels]
        target[: len(stated)] = stated
    scaled = (values - offset) * (scale * (positive_number(analog, "GEN_SCALE") or 1.0))
    return replace(made, values=np.nan_to_num(scaled, nan=0.0, posinf=0.0, neginf=0.0))


@dataclass(frozen=True)
class ForcePlates:
    """Forces of plates on the person who walked over them, at the rate of the markers; z up."""

    force: Float[np.ndarray, "time plates 3"]
    """On the person, newtons; zero where the plate is not loaded."""
    centre: Float[np.ndarray, "time plates 3"]
    """Centre of pressure on the plate's surface, metres; zero where it is not loaded."""
    torque: Float[np.ndarray, "time plates"]
    """Moment about the vertical at the centre of pressure, newton metres."""
    loaded: Bool[np.ndarray, "time plates"]
    corners: Float[np.ndarray, "plates 4 3"]
    """Metres."""
    fps: float
    start_time: float
    """Seconds of the markers' clock."""
    decisions: tuple[str, ...]
    """What was guessed, left out or put right, a sentence each."""


def read_force_plates(path: Path) -> ForcePlates:
    """Read the force plates of a .c3d file, averaged over every frame of markers.

    Types 1 (force, centre of pressure, moment), 2 (force, moment), 3 (eight Kistler channels) and
    4 (type 2 with a calibration matrix). The axis normal to the plates points up, and so do loads.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or has no plate that can be read; the message says why.
    """
    analog = read_analog(path)
    types = analog.numbers("FORCE_PLATFORM", "TYPE", -1)
    corners = analog.numbers("FORCE_PLATFORM", "CORNERS", -1, 4, 3)
    origins = analog.numbers("FORCE_PLATFORM", "ORIGIN", -1, 3)
    if len(types) == 0 or min(len(corners), len(origins)) < len(types):
        raise FormatError(f"{path}: expected force plates (FORCE_PLATFORM), but it has none")
    metres = units.METRES[parse_unit(" ".join(analog.texts("POINT", "UNITS"))) or "mm"]
    kept: list[_Plate] = []
    notes: list[str] = []
    for k, kind in enumerate(types.astype(int)):
        try:
            wrench = _wrench(analog, k, int(kind), metres * origins[k], metres)
            plate, said = _oriented_plate(wrench, metres * corners[k])
            kept.append(plate)
            notes += [f"force plate {k + 1}: {one}" for one in said]
        except FormatError as error:
            notes.append(f"force plate {k + 1} left out: {error}")
    if not kept:
        raise FormatError(f"{path}: no force plate can be read; {'; '.join(notes)}")
    ups: tuple[Up, ...] = ("x", "y", "z")
    turn = units.to_z_up(ups[int(np.abs([one.axes[:, 2] for one in kept]).sum(0).argmax())])
    force, centre, torque = (
        np.stack([getattr(one, name) for one in kept], 1) @ turn.T
        for name in ("force", "centre", "torque")
    )
    return ForcePlates(
        force=force,
        centre=centre,
        torque=torque[..., 2],
        loaded=np.stack([one.force.any(-1) for one in kept], 1),
        corners=np.stack([one.corners for one in kept]) @ turn.T,
        fps=analog.fps,
        start_time=analog.start_time,
        decisions=tuple(notes),
    )


@dataclass(frozen=True)
class _Plate:
    """One force plate with its loads, in the file's axes; metres, newtons, newton metres."""

    corners: Float[np.ndarray, "4 3"]
    axes: Float[np.ndarray, "3 3"]
    """The plate's own axes as columns; z is its normal."""
    force: Float[np.ndarray, "time 3"]
    centre: Float[np.ndarray, "time 3"]
    torque: Float[np.ndarray, "time 3"]
    """Along the normal."""


def _wrench(
    analog: AnalogChannels, plate: int, kind: int, origin: Float[np.ndarray, "3"], metres: float
) -> Float[np.ndarray, "time 9"]:
    """Return force, moment at the plate's origin, and moment to add at its surface; N, N m.

    Raises:
        FormatError: when its type or channels are not known.
    """
    if kind not in _CHANNELS:
        raise FormatError(f"expected a plate of type 1 to 4, got type {kind}")
    plates = len(analog.numbers("FORCE_PLATFORM", "TYPE", -1))
    channels = analog.numbers("FORCE_PLATFORM", "CHANNEL", plates, -1).astype(int) - 1
    rows = channels[plate, : _CHANNELS[kind]] if len(channels) > plate else np.zeros(0, int)
    if len(rows) < _CHANNELS[kind] or not 0 <= rows.min() <= rows.max() < analog.values.shape[-1]:
        raise FormatError("the file lacks the plate's channels")
    values = _frame_means(analog, rows, kind)
    words = [word.lower() for word in analog.texts("ANALOG", "UNITS")]
    last = words[rows[-1]] if len(words) > rows[-1] else ""
    lever = 1e-3 if "mm" in last else 1.0 if "m" in last and "v" not in last else metres
    # vector from the plate's origin up to its surface; some files store it with opposite signs
    surface = -origin if origin[2] > 0 else origin
    if kind == 4:
        matrix = analog.numbers("FORCE_PLATFORM", "CAL_MATRIX", -1, 6, 6)
        if len(matrix) <= plate:
            raise FormatError("the file lacks the plate's calibration matrix")
        values = values @ matrix[plate]
    if kind == 3:
        a, b = np.abs(origin[:2])
        x12, x34, y14, y23, z1, z2, z3, z4 = values.T
        force = np.stack((x12 + x34, y14 + y23, z1 + z2 + z3 + z4), -1)
        tilt = b * (z1 + z2 - z3 - z4), a * (z2 + z3 - z1 - z4)
        moment = np.stack((*tilt, b * (x34 - x12) + a * (y14 - y23)), -1)
        surface = np.array([0.0, 0.0, surface[2]])
    elif kind == 1:
        force, place = values[:, :3], np.pad(metres * values[:, 3:5], ((0, 0), (0, 1)))
        moment = np.cross(place, force) + np.pad(lever * values[:, 5:], ((0, 0), (2, 0)))
        surface = np.zeros(3)
    else:
        force, moment = values[:, :3], lever * values[:, 3:]
    return np.concatenate((force, moment, np.cross(force, surface)), -1)


def _frame_means(
    analog: AnalogChannels, rows: np.ndarray, kind: int
) -> Float[np.ndarray, "time channels"]:
    """Return channels' mean signals around every frame, minus their values without load.

    FORCE_PLATFORM:ZERO names the samples of an empty plate, from 1; 0 is none. The centre of
    pressure, which plates of type 1 state, has no value without load, and stays as it is.
    """
    from scipy.ndimage import uniform_filter1d

    values = analog.values[..., rows]
    samples = values.shape[1]
    flat = values.reshape(-1, len(rows))
    span = analog.numbers("FORCE_PLATFORM", "ZERO", -1).astype(int)
    if len(span) >= 2 and 1 <= span[0] <= span[1] <= len(flat):
        empty = flat[span[0] - 1 : span[1]].mean(0)
        empty[3:5] *= kind != 1
        # subtract the unloaded signal, unless somebody already stood on the plate
        flat = flat - empty if np.abs(empty[:3]).max() < BASELINE_N else flat
    return uniform_filter1d(flat, samples, axis=0, mode="nearest")[::samples]


def _oriented_plate(
    wrench: Float[np.ndarray, "time 9"], corners: Float[np.ndarray, "4 3"]
) -> tuple[_Plate, list[str]]:
    """Return a plate with its loads, and notes on corrected signs and units of moments.

    Raises:
        FormatError: when its corners are no rectangle, or the centre of pressure is beside it.
    """
    x, y = corners[0] - corners[1], corners[0] - corners[3]
    sides = np.linalg.norm(x), np.linalg.norm(y)
    size = np.abs(corners).max()
    flat = size < 1e3 and min(sides) > 0.05 and abs(x @ y) < 0.05 * sides[0] * sides[1]
    if not flat:
        raise FormatError("the plate's corners are no rectangle")
    z = np.cross(x, y)
    axes = np.stack((x, np.cross(z, x), z), -1)
    axes /= np.linalg.norm(axes, axis=0)
    notes: list[str] = []
    # forces on the person point up, along the laboratory axis nearest to the plate's normal
    upwards = np.sign(axes[np.abs(z).argmax(), 2])
    if (strong := np.abs(wrench[:, 2]) > LOADED_N).any() and (
        np.sum(wrench[strong, 2]) * upwards < 0
    ):
        wrench = -wrench
        notes.append("its forces are those on the plate; turned into those on the person")
    loaded = wrench[:, 2] * upwards > LOADED_N
    force, divisor = wrench[:, :3], np.where(loaded, wrench[:, 2], np.inf)
    moments = {factor: factor * wrench[:, 3:6] + wrench[:, 6:] for factor in _MOMENT_UNITS}
    places = {
        factor: np.cross([0.0, 0.0, 1.0], moment) / divisor[:, None]
        for factor, moment in moments.items()
    }
    edges = np.array([*sides, 0.0]) / 2 + BESIDE_M
    near = {factor: (np.abs(p[loaded]) < edges).all(-1) for factor, p in places.items()}
    right = [factor for factor, on in near.items() if not loaded.any() or on.mean() > INSIDE]
    if not right:
        raise FormatError(
            "the centre of pressure lies beside the plate: check the plate's channels and corners"
        )
    factor = right[0]
    if _MOMENT_UNITS[factor]:
        notes.append(f"its moments are in {_MOMENT_UNITS[factor]}, whatever the file says")
    local = places[factor]
    twist = (moments[factor] - np.cross(local, force)) * [0.0, 0.0, 1.0]
    return _Plate(
        corners=corners,
        axes=axes,
        force=force @ axes.T * loaded[:, None],
        centre=(local @ axes.T + corners.mean(0)) * loaded[:, None],
        torque=twist @ axes.T * loaded[:, None],
    ), notes
