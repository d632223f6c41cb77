"""One person followed through clouds that show other things, or other people, as well."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from recon.core.geometry.planes import clusters

_LARGE = 0.4
"""Share of the largest thing's points that another one has which may be the person."""
_BESIDE = 0.5
"""Metres, along the ground, between the middles of things that are no parts of one person. An
occluder may divide a body in two, which stand above each other."""
_TALL = 1.0
"""Metres from corner to corner that a whole person measures at least, crouching; what is smaller
may be a limb that an occluder cuts off."""
_OFTEN = 0.1
"""Share of the frames with points in which something must stand beside to be worth a word."""


@dataclass(frozen=True)
class Alone:
    """The points of one thing in every frame."""

    clouds: list[np.ndarray]
    """Axes (points, 3), each frame its own number of points; metres."""
    beside: int
    """Frames in which something else of a person's size stands beside; 0 for a few."""


@dataclass(frozen=True)
class _Frame:
    """The things of one frame that may be the person, the largest first."""

    label: Int[np.ndarray, " points"]
    middles: Float[np.ndarray, "things 3"]
    sizes: Float[np.ndarray, " things"]
    """Metres from corner to corner of the box around a thing."""
    second: float
    """Share of the largest one's points that the second has."""


def alone(clouds: list[np.ndarray], reach: float) -> Alone:
    """The largest thing of the clearest frame, followed to both ends by the nearest middle.

    Taken for itself, the largest thing of every frame would change between two people.

    Args:
        clouds: points of every frame, z up, metres, without the ground; frames may be empty.
        reach: metres of the steps that join points to one thing.
    """
    frames = [_frame(cloud, reach) for cloud in clouds]
    shown = [k for k, one in enumerate(frames) if one is not None]
    kept = [cloud[:0] for cloud in clouds]
    if not shown:
        return Alone(kept, 0)
    clearest = min(range(len(shown)), key=lambda k: _of(frames, shown[k]).second)
    beside = 0
    for way in (shown[clearest:], shown[:clearest][::-1]):
        last = _of(frames, shown[clearest]).middles[0]
        for k in way:
            one = _of(frames, k)
            chosen = int(np.linalg.norm(one.middles - last, axis=-1).argmin())
            last = one.middles[chosen]
            kept[k] = clouds[k][one.label == chosen]
            away = np.linalg.norm((one.middles - last)[:, :2], axis=-1)
            beside += bool(((away > _BESIDE) & (one.sizes > _TALL)).any())
    return Alone(kept, beside if beside > _OFTEN * len(shown) else 0)


def _of(frames: list[_Frame | None], number: int) -> _Frame:
    one = frames[number]
    assert one is not None
    return one


def _frame(cloud: Float[np.ndarray, "points 3"], reach: float) -> _Frame | None:
    if len(cloud) == 0:
        return None
    label = clusters(cloud, reach)
    size = np.bincount(label)
    large = int((size >= _LARGE * size[0]).sum())
    things = [cloud[label == k] for k in range(large)]
    return _Frame(
        label,
        middles=np.stack([np.median(thing, axis=0) for thing in things]),
        sizes=np.array([np.linalg.norm(np.ptp(thing, axis=0)) for thing in things]),
        second=float(size[1] / size[0]) if len(size) > 1 else 0.0,
    )
