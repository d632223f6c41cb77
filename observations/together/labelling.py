"""Clouds that nobody has labelled are looked at by the bundled network."""

from collections.abc import Sequence
from functools import cache

from observations.depth import PointCloud
from observations.together import kinds
from priors.labels.looking import CloudLabeller
from recon.method.protocols import Sensor


def labelled(observations: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """The observations with labels for their clouds, unless other points in space have names.

    Those tell the posture better than labels do.
    """
    if kinds.tracked(observations):
        return tuple(observations)
    return tuple(
        with_labels(one) if isinstance(one, PointCloud) and one.labels is None else one
        for one in observations
    )


def with_labels(cloud: PointCloud) -> PointCloud:
    """The cloud with what the bundled network believes of its points."""
    eyes = None
    if cloud.camera is not None:
        eyes = cloud.camera.at(range(cloud.moments)).T_world_camera[..., :3, 3]
    level = cloud.ground_known or cloud.ground_seen
    found = _labeller()(cloud.points, cloud.present, cloud.fps, eyes, level=level)
    return cloud.derived(labels=found.to(dtype=cloud.points.dtype))


@cache
def _labeller() -> CloudLabeller:
    """The bundled network, loaded once."""
    return CloudLabeller.load()
