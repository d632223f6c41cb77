"""What kinds of sensors a clip has; ask the sensors: `named`, `view`, `cloud`, `places`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from recon.method.sensor import Sensor
from recon.method.sensor import unposed_camera as unposed_camera

if TYPE_CHECKING:
    from observations.depth import PointCloud
    from observations.keypoints2d import Keypoints2D
    from observations.points import TrackedPoints

    Tracked = TrackedPoints
    InSpace = TrackedPoints | PointCloud
else:
    # a clip loads the code of those sensors alone that it has
    TrackedPoints = Tracked = InSpace = Keypoints2D = PointCloud = Sensor


def tracked(observations: Sequence[Sensor]) -> list[TrackedPoints]:
    """Joints, markers and keypoints: points in space with names."""
    return [named for one in observations if (named := one.named)]


def markers(observations: Sequence[Sensor]) -> list[TrackedPoints]:
    """Markers on the skin."""
    return [one for one in tracked(observations) if one.on_skin]


def in_space(observations: Sequence[Sensor]) -> list[InSpace]:
    """Joints, markers, keypoints and clouds, in the order given."""
    return [found for one in observations if (found := one.named or one.cloud)]


def is_in_space(one: Sensor) -> bool:
    """Whether a sensor gives places in space, metres."""
    return one.places is not None


def views(observations: Sequence[Sensor]) -> list[Keypoints2D]:
    """Keypoints in images."""
    return [view for one in observations if (view := one.view)]


def clouds(observations: Sequence[Sensor]) -> list[PointCloud]:
    """Points without names."""
    return [cloud for one in observations if (cloud := one.cloud)]


def camera_frame_is_recording(seen: Sensor) -> bool:
    """Whether a fixed camera's pose is the identity, as it is where nobody gave one."""
    return seen.unposed
