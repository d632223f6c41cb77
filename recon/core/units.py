"""Units of length and axes that point up: their names and conversions."""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from recon.core.errors import UnitsError

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = get_args(Axis)
Up = Literal["x", "y", "z", "x-down", "y-down", "z-down"]
"""The direction that is up: along an axis, or against one, as y points down in cameras."""
Hand = Literal["left", "right"]
"""Handedness of coordinates; those of Unity, of Kinect's colour image and of mirrors are left."""

Unit = str
"""One of `METRES`, or metres per unit as a number: "0.3048"."""


class _Metres(dict[str, float]):
    """Metres per unit of length; keys are unit names, or numbers as text such as "0.3048"."""

    def __missing__(self, unit: str) -> float:
        if (word := _SPELLINGS.get(unit.strip().lower())) is not None:
            return self[word]
        try:
            metres = float(unit)
        except ValueError:
            metres = 0.0
        if not 0 < metres < float("inf"):
            raise KeyError(unit)
        return metres


METRES = _Metres(m=1.0, cm=0.01, mm=0.001, inch=0.0254, ft=0.3048, cmu=0.0254 / 0.45)
"""Metres per unit; `cmu` is the unit of the CMU database's ASF files, inches over 0.45."""

_SPELLINGS = {
    "meter": "m", "metre": "m", "meters": "m", "metres": "m",
    "centimeter": "cm", "centimetre": "cm", "centimeters": "cm", "centimetres": "cm",
    "millimeter": "mm", "millimetre": "mm", "millimeters": "mm", "millimetres": "mm",
    "in": "inch", "inches": "inch", "foot": "ft", "feet": "ft",
}  # fmt: skip


def parse_unit(text: str) -> str | None:
    """Return the unit ("m", "mm", ...) for a spelling in a file; None if it is unknown."""
    word = text.strip().lower()
    word = _SPELLINGS.get(word, word)
    return word if word in METRES else None


def check_unit(unit: str | None) -> None:
    """Refuse an unknown unit of length.

    Raises:
        ValueError: with the units that are.
    """
    try:
        METRES["m" if unit is None else unit]
    except KeyError:
        raise UnitsError(
            f"--unit is one of {', '.join(METRES)}, or metres per unit as a number, got {unit!r}"
        ) from None


def to_z_up(up: Up) -> Float[np.ndarray, "3 3"]:
    """Rotation from coordinates with this up axis to coordinates with z up.

    From y up it is a quarter turn about x, (x, y, z) -> (x, -z, y), as in AMASS and Blender; from
    x up the cyclic (x, y, z) -> (y, z, x). From y down it is (x, y, z) -> (x, z, -y), which keeps
    x to the right and what is far from a camera ahead.
    """
    rows = {
        "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
        "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
        "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        "x-down": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
        "y-down": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
        "z-down": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    }
    return np.array(rows[up], dtype=np.float64)


def snapped_rate(fps: float) -> float:
    """Round a frame rate that comes from a rounded interval: 1 / 0.0083333 gives 120 Hz."""
    whole = round(fps)
    return float(whole) if whole > 0 and abs(fps - whole) < 2e-4 * whole else float(fps)
