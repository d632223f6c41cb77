"""Settings that the command line shows; light to import."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class FitSettings:
    """How to fit files."""

    prior: Literal["humor", "pose"] = "humor"
    """What is likely: `humor` is every step from pose to pose and where feet touch, `pose` single
    poses and smoothness (stages 1-2 of HuMoR)."""
    weights: str = "open"
    """Of HuMoR: `open`, `nc` (not for commercial use; in a source checkout) or a file."""
    body: Path | None = None
    """A SMPL-family file of your own; default: the bundled body."""
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None
    """Unit of the positions, where the file is wrong about it."""
    up: Literal["x", "y", "z"] | None = None
    """Axis that points up, where the file is wrong about it."""
    noise: float | None = None
    """Standard deviation of every coordinate of the data, metres; default: told from the data."""
    robust: float | None = None
    """Distance in metres beyond which a point counts ever less; default: least squares."""
    fps: float | None = None
    """Rate of the result; default: that of the first observation."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where to compute."""
    seed: int = 0
    """Of everything random."""


DEFAULTS = FitSettings()
