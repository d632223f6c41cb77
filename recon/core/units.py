"""Units of length and axes that point up: their names, conversions, and units by a body's size."""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from recon.core.errors import UnitsError

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = get_args(Axis)
Up = Literal["x", "y", "z", "x-down", "y-down", "z-down"]
"""The direction that is up: along an axis, or against one, as y points down in cameras."""

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45}
"""Metres per unit; `cmu` is the unit of the CMU database's ASF files, inches over 0.45."""

_SPELLINGS = {
    "meter": "m", "metre": "m", "meters": "m", "metres": "m",
    "centimeter": "cm", "centimetre": "cm", "centimeters": "cm", "centimetres": "cm",
    "millimeter": "mm", "millimetre": "mm", "millimeters": "mm", "millimetres": "mm",
    "in": "inch", "inches": "inch",
}  # fmt: skip

_BODY_LENGTH = (1.0, 2.2)
"""Metres along the bones from the head to a foot: children to the tallest adults. Narrower than
the closest pair of candidate units (a ratio of 2.22), so no length fits two of them."""
_MARKER_EXTENT = (0.5, 2.5)
"""Metres spanned by markers, upright or crouched; only m, cm and mm can be told apart by it."""
_SANE_EXTENT = (0.05, 10.0)
"""Metres; outside it no body was recorded and the unit a file declares is wrong."""


def parse_unit(text: str) -> str | None:
    """One of `METRES` for the spelling used in a file; None for an empty or foreign word."""
    word = text.strip().lower()
    word = _SPELLINGS.get(word, word)
    return word if word in METRES else None


def unit_from_bones(length: float, name: str) -> tuple[str, str]:
    """Unit in which a head-to-foot bone path is as long as that of a person, and the reason.

    Raises:
        ValueError: when no unit fits.
    """
    low, high = _BODY_LENGTH
    fitting = [unit for unit, metres in METRES.items() if low <= length * metres <= high]
    if len(fitting) != 1:
        raise UnitsError(
            f"{name}: the bones from head to foot measure {length:.4g} units, which is "
            f"{low} m to {high} m in none of {', '.join(METRES)}; give the unit with --unit"
        )
    metres = METRES[fitting[0]]
    return fitting[
        0
    ], f"unit {fitting[0]}: head to foot is {length * metres:.2f} m along the bones"


def unit_from_markers(extent: float, name: str) -> tuple[str, str]:
    """Unit in which markers span as much as a person, and the reason.

    Raises:
        ValueError: when no unit fits.
    """
    low, high = _MARKER_EXTENT
    fitting = [unit for unit in ("m", "cm", "mm") if low <= extent * METRES[unit] <= high]
    if len(fitting) != 1:
        raise UnitsError(
            f"{name}: the markers span {extent:.4g} units, which is {low} m to {high} m in none "
            "of m, cm, mm; give the unit with --unit"
        )
    return fitting[0], f"unit {fitting[0]}: the markers span {extent * METRES[fitting[0]]:.2f} m"


def check_declared(unit: str, size: float, name: str) -> str:
    """The reason for a unit that the file itself states, once its size is possible.

    Raises:
        ValueError: when no body has that size.
    """
    metres = size * METRES[unit]
    if not _SANE_EXTENT[0] <= metres <= _SANE_EXTENT[1]:
        raise UnitsError(
            f"{name}: the file says its unit is {unit}, but then the body measures "
            f"{metres:.4g} m; give the true unit with --unit"
        )
    return f"unit {unit}: stated by the file"


def check_override(unit: str | None) -> None:
    """Refuse a unit that is not known.

    Raises:
        ValueError: with the units that are.
    """
    if unit is not None and unit not in METRES:
        raise UnitsError(f"--unit is one of {', '.join(METRES)}, got {unit!r}")


def to_z_up(up: Up) -> Float[np.ndarray, "3 3"]:
    """Proper rotation that takes coordinates with this up axis to z up.

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
    """A whole number of frames per second where rounding in the file hid one (1 / 0.0083333)."""
    whole = round(fps)
    return float(whole) if whole > 0 and abs(fps - whole) < 2e-4 * whole else float(fps)
