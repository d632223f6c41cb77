"""Finds a body among points without names: its pose, and which point is which marker.

Usual poses are turned about the vertical and laid over the points; the likeliest are fitted to
the points that lie nearest to their markers, which are then assigned again (iterative closest
points, with one point for a marker).
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from recon.core import rotations as so3
from recon.ingest.marker_places import MarkedBody
from recon.ingest.marker_poses import Poses, pose_density
from recon.ingest.tied_frames import LevenbergMarquardt, minimise_frames

_TURNS, _USUAL, _NEAR, _TRIED = 16, 40, 200, 12
"""Turns about the vertical, poses that are tried at first, those whose points are assigned, and
those that are fitted."""
_APART = 0.6
"""Metres between points of a body and those of others or of objects."""
_REACH = (0.3, 0.25, 0.2, 0.16, 0.13, 0.1, 0.1, 0.1)
"""Metres beyond which a point is no marker, by iteration."""
_UNUSUAL = 0.01
"""Share of markers that do not fit that weighs as much as a unit of `FoundBody.unusual`."""
_FEW = LevenbergMarquardt(max_iterations=5, tolerance=1e-2, damping=1e-2)


@dataclass(frozen=True)
class FoundBody:
    """A body that was found among points without names."""

    body: MarkedBody
    pose: Poses
    marker: Int[np.ndarray, " points"]
    """The marker that every point is, -1 of others."""
    cost: float
    """Share of markers and points that do not fit, 0 to 1."""
    unusual: float
    """Mean squared coordinate of the pose in the density of poses; about 1 of usual ones."""

    @property
    def rank(self) -> float:
        """Cost with a penalty on unusual poses, since legs put on backwards fit as well."""
        return self.cost + _UNUSUAL * self.unusual


def found_body(
    points: Float[np.ndarray, "points 3"], bodies: list[MarkedBody], effort: int
) -> FoundBody:
    """The body of those given that fits some points best.

    Args:
        points: of one frame, metres.
        bodies: one of them is there.
        effort: 1 to try the first poses of each, 3 to try all, thrice as many of them closely.
    """
    points, among = _one_body(points)
    upright = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]))
    placed: list[np.ndarray] = []
    for own in bodies:
        some = own.poses if effort > 1 else own.poses[:_USUAL]
        turns = torch.cat((upright.expand(len(some), 1, 3, 3), some), 1)
        poses = own.posed(torch.zeros(len(turns), 3), turns)
        placed.append(own.places(poses))
    every = np.stack(placed)
    every -= every.mean(2, keepdims=True)
    angles = 2 * np.pi * np.arange(_TURNS) / _TURNS
    about = so3.exp(torch.tensor(angles)[:, None] * torch.tensor([0.0, 0.0, 1.0]).double()).numpy()
    turned = np.einsum("tij,bpmj->bptmi", about, every)
    shape, middle = turned.shape[:3], np.median(points, 0)
    flat = turned.reshape(-1, *turned.shape[3:])
    flat = flat - np.median(flat, 1, keepdims=True) + middle
    rough = _chamfer_distances(flat, points)
    likely = np.argsort(rough)[: _NEAR * effort]
    costs = np.array([assigned(one, points, _REACH[0])[1] for one in flat[likely]])
    best: FoundBody | None = None
    chosen = likely[np.argsort(costs)[: _TRIED * effort]]
    where = np.stack(np.unravel_index(chosen, shape), 1)
    for b in np.unique(where[:, 0]).tolist():
        rows = np.flatnonzero(where[:, 0] == b)
        body, poses = bodies[b], where[rows, 1]
        roots = torch.tensor(about[where[rows, 2]]).float() @ upright
        turns = torch.cat((roots[:, None], body.poses[poses]), 1)
        start = body.posed(torch.zeros(len(rows), 3), turns)
        rests = body.places(start)
        shift = torch.tensor((flat[chosen[rows]] - rests).mean(1)).float()
        for found in _fits_of_poses(body, body.posed(shift, turns), points):
            if best is None or found.rank < best.rank:
                best = found
    assert best is not None
    marker = np.full(len(among), -1)
    marker[among] = best.marker
    return replace(best, marker=marker)


def _one_body(
    points: Float[np.ndarray, "points 3"],
) -> tuple[Float[np.ndarray, "some 3"], Bool[np.ndarray, " points"]]:
    """The largest group of points that is apart from all others, and a mask of it."""
    from scipy.cluster.hierarchy import fclusterdata

    group = fclusterdata(points, _APART, "distance") if len(points) > 1 else np.ones(len(points))
    names, counts = np.unique(group, return_counts=True)
    among = group == names[counts.argmax()]
    return points[among], among


def _fits_of_poses(
    body: MarkedBody, state: Poses, points: Float[np.ndarray, "points 3"]
) -> list[FoundBody]:
    """Poses of one body fitted to the points, and how well each fits."""
    count = len(state.translation)
    found: list[tuple[np.ndarray, float]] = []
    for reach in _REACH:
        places = body.places(state)
        found = [assigned(one, points, reach) for one in places]
        x, seen = np.zeros_like(places), np.zeros(places.shape[:2], bool)
        for k, (marker, _) in enumerate(found):
            held = np.flatnonzero(marker >= 0)
            x[k, marker[held]], seen[k, marker[held]] = points[held], True
        state = minimise_frames(body.energies(x, seen), state, _FEW).state
    places = body.places(state)
    found = [assigned(one, points, _REACH[-1]) for one in places]
    unusual = pose_density().coordinates(state.rotations[:, 1:]).square().mean(-1).tolist()
    return [FoundBody(body, state[[k]], *found[k], unusual[k]) for k in range(count)]


def assigned(
    places: Float[np.ndarray, "markers 3"], points: Float[np.ndarray, "points 3"], reach: float
) -> tuple[Int[np.ndarray, " points"], float]:
    """Marker of every point, -1 beyond `reach`, by the least sum of squares; and its mean cost."""
    from scipy.optimize import linear_sum_assignment

    away = ((points[:, None] - places) ** 2).sum(-1) / reach**2
    capped = np.minimum(away, 1.0)
    rows, columns = linear_sum_assignment(capped)
    marker = np.full(len(points), -1)
    good = away[rows, columns] < 1
    marker[rows[good]] = columns[good]
    fewer = min(away.shape)
    return marker, float(capped[rows, columns].sum() / fewer)


def _chamfer_distances(
    places: Float[np.ndarray, "poses markers 3"], points: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, " poses"]:
    """Mean squared distances from places to the nearest points and back, capped."""
    a, b = torch.from_numpy(places).float(), torch.from_numpy(points).float()
    away = torch.cdist(a, b.expand(len(a), *b.shape)).clamp(max=_REACH[0]).square()
    return (away.amin(1).mean(-1) + away.amin(2).mean(-1)).numpy()
