"""Settings of simulated sensors for the command line; quick to import."""

from dataclasses import dataclass
from typing import Literal

SensorKind = Literal["joints3d", "markers3d", "landmarks", "keypoints2d", "depth", "scans"]
"""What a simulated sensor gives: the 22 joints, 43 points of the skin, 16 markers beside the skin,
keypoints in images, points that a depth camera sees, points all over the skin."""


FurnitureName = Literal["chair", "table", "box", "board"]
"""What can stand around a person in the view of a simulated depth sensor."""
LeftOver = Literal["ground", "furniture"]
"""What a segmentation of a depth image may leave beside the body."""


@dataclass(frozen=True)
class FilmSettings:
    """Settings of simulated cameras, for the kinds keypoints2d and depth."""

    camera: str = "front"
    """`front` or `side` of the body, near enough to fill the image, or a calibration."""
    views: int = 1
    """Number of cameras, evenly around the body from `camera` on; for several, OUT is a folder."""
    orbit: float = 0.0
    """Angle that the cameras are carried around the body by, radians."""
    layout: str = "openpose25"
    """Layout of the keypoints."""


FILM_DEFAULTS = FilmSettings()


@dataclass(frozen=True)
class SurfaceSettings:
    """Settings of simulated surfaces, for the kinds landmarks, depth and scans."""

    points: int = 4096
    """Largest number of points per frame, for depth and scans."""
    clothed: int | None = None
    """Seed of the clothes that depth and scans see; default: bare skin."""
    skin_offset: float = 0.01
    """Standard deviation per axis of how far landmarks are placed from where they should be,
    metres."""
    furniture: tuple[FurnitureName, ...] = ()
    """Furniture around the person that a depth sensor sees: a chair behind, a table at the left, a
    box at the right, a board before the shins."""
    left_over: tuple[LeftOver, ...] = ()
    """What remains in the clouds of a depth sensor beside the body: `ground`, `furniture`."""


SURFACE_DEFAULTS = SurfaceSettings()
