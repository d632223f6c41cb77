"""Sensors of a clip by what they see, for checks; others ask `named`, `view` and `cloud`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from recon.method.sensor import Sensor
from recon.method.sensor import views_of as views

if TYPE_CHECKING:
    from observations.depth import PointCloud
    from observations.points import TrackedPoints
    from observations.points import TrackedPoints as Tracked
else:  # the code of a sensor is loaded with its data
    TrackedPoints = Tracked = PointCloud = Sensor

__all__ = ["Tracked", "clouds", "markers", "tracked", "views"]


def tracked(observations: Sequence[Sensor]) -> list[TrackedPoints]:
    """Joints, markers and keypoints: points in space with names."""
    return [named for one in observations if (named := one.named)]


def markers(observations: Sequence[Sensor]) -> list[TrackedPoints]:
    """Markers on the skin."""
    return [one for one in tracked(observations) if one.on_skin]


def clouds(observations: Sequence[Sensor]) -> list[PointCloud]:
    """Points without names."""
    return [cloud for one in observations if (cloud := one.cloud)]
