"""Finds the pose of a body among points without names, and the marker that each point is.

Common poses are turned about the vertical and laid over the points; those nearest to the points
are fitted by iterative closest points: each marker is assigned at most one point, the pose is
fitted to the assigned points, and points are assigned again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from recon.core import rotations as so3
from recon.core.struct import concatenate
from recon.ingest.marker_places import MarkedBody
from recon.ingest.marker_poses import Poses, pose_density
from recon.ingest.tied_frames import LevenbergMarquardt, minimise_frames

_TURNS, _USUAL, _NEAR, _TRIED = 16, 40, 200, 12
"""Number of turns about the vertical; of poses tried at first; of turned poses whose markers are
assigned to points; and of those that are fitted."""
_APART = 0.6
"""Distance (m) between neighbouring points beyond which they belong to different bodies."""
_REACH = (0.3, 0.25, 0.2, 0.16, 0.13, 0.1, 0.1, 0.1)
"""Greatest distance (m) of a point from the marker assigned to it, for each iteration."""
_DROPS = (1, 2, 3)
"""Iterations before which the worse half of the poses is dropped."""
_UNUSUAL = 0.01
"""Share of markers that do not fit that weighs as much as a unit of `FoundBody.unusual`."""
_LIMBS = [
    *((joint, 1) for joint in (1, 2, 4, 5, 7, 8, 12)),
    *((joint, 0) for joint in range(16, 20)),
]
"""Joints of limbs and head, and the number of the axis along each in the rest pose."""
_QUARTERS = (0.5 * np.pi, np.pi, 1.5 * np.pi)
"""Turns of a limb about its length that may exchange its markers."""
_CLOSE, _BETTER, _FINISHED = 4, 0.9, 4
"""Iteration at which fits of nearly right poses begin; ratio of ranks below which a turn is kept;
and number of turns that are fitted beyond the first iteration."""
_FEW = LevenbergMarquardt(max_iterations=5, tolerance=1e-2, damping=1e-2)


@dataclass(frozen=True)
class FoundBody:
    """The fit of a body to the points of one frame: pose, assigned markers, cost."""

    body: MarkedBody
    pose: Poses
    marker: Int[np.ndarray, " points"]
    """Number of the marker that each point is, -1 for points that are none."""
    cost: float
    """Mean squared distance of assigned points, capped: 0 where all fit, 1 where none does."""
    unusual: float
    """Mean squared coordinate of the pose in the pose density; about 1 for common poses."""

    @property
    def rank(self) -> float:
        """Cost plus a penalty on rare poses, since legs turned backwards fit points as well."""
        return self.cost + _UNUSUAL * self.unusual


def found_bodies(
    clouds: Sequence[Float[np.ndarray, "points 3"]], bodies: list[MarkedBody], effort: int
) -> list[FoundBody]:
    """Fit several bodies to the points of each frame; return the best fit of each frame.

    Args:
        clouds: the points of each frame, metres.
        bodies: candidates, of which the frames show one.
        effort: 1 to try the first poses of each, 3 to try the others, thrice as many closely.
    """
    upright = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0]))
    tried = slice(_USUAL) if effort == 1 else slice(_USUAL, None)
    placed: list[np.ndarray] = []
    for own in bodies:
        some = own.poses[tried]
        turns = torch.cat((upright.expand(len(some), 1, 3, 3), some), 1)
        poses = own.posed(torch.zeros(len(turns), 3), turns)
        placed.append(own.places(poses))
    every = np.stack(placed)
    every -= every.mean(2, keepdims=True)
    angles = 2 * np.pi * np.arange(_TURNS) / _TURNS
    about = so3.exp(torch.tensor(angles)[:, None] * torch.tensor([0.0, 0.0, 1.0]).double()).numpy()
    turned = np.einsum("tij,bpmj->bptmi", about, every)
    flat = turned.reshape(-1, *turned.shape[3:])
    flat = flat - np.median(flat, 1, keepdims=True)
    points, among = zip(*map(_largest_group, clouds), strict=True)
    chosen = [_likely_places(flat, own, effort) for own in points]
    cloud = np.repeat(np.arange(len(points)), [len(one) for one in chosen])
    which = np.concatenate(chosen)
    of_body, of_pose, of_turn = np.unravel_index(which, turned.shape[:3])
    best: dict[int, FoundBody] = {}
    for b in np.unique(of_body).tolist():
        body, rows = bodies[b], np.flatnonzero(of_body == b)
        roots = torch.tensor(about[of_turn[rows]]).float() @ upright
        turns = torch.cat((roots[:, None], body.poses[tried][of_pose[rows]]), 1)
        rests = body.places(body.posed(torch.zeros(len(rows), 3), turns))
        middle = np.stack([np.median(points[k], 0) for k in cloud[rows].tolist()])
        shift = torch.tensor((flat[which[rows]] - rests).mean(1) + middle).float()
        for k, found in _fits_of_poses(body, body.posed(shift, turns), points, cloud[rows]):
            if k not in best or found.rank < best[k].rank:
                best[k] = found
    for k, one in enumerate(among):
        marker = np.full(len(one), -1)
        marker[one] = best[k].marker
        best[k] = replace(best[k], marker=marker)
    return [best[k] for k in range(len(among))]


def with_limb_turned(
    body: MarkedBody, poses: Poses, clouds: Sequence[Float[np.ndarray, "points 3"]]
) -> list[FoundBody] | None:
    """Return fits with one limb turned about its length; None where no turn is clearly better.

    Exchanged markers of a hand, foot or head fit one frame nearly as well as right ones, but not
    several frames together.

    Args:
        body: with markers.
        poses: in which it was found, one for each frame.
        clouds: the points of each frame, metres.
    """
    turns = [(0, 1, 0.0), *((j, axis, angle) for j, axis in _LIMBS for angle in _QUARTERS)]
    rotations = poses.rotations.repeat(len(turns), 1, 1, 1).unflatten(0, (len(turns), -1))
    for own, (j, axis, angle) in zip(rotations, turns, strict=True):
        own[:, j] = own[:, j] @ so3.exp(angle * torch.eye(3)[axis])
    state = body.posed(poses.translation.repeat(len(turns), 1), rotations.flatten(0, 1))
    found, ranks = _fits_to_all(body, state, clouds, range(_CLOSE, _CLOSE + 1))
    likely = [0, *(1 + np.argsort(ranks[1:])[:_FINISHED]).tolist()]  # 0: no limb turned
    state = concatenate([one.pose for k in likely for one in found[k]])
    found, ranks = _fits_to_all(body, state, clouds, range(_CLOSE + 1, len(_REACH)))
    best = int(ranks.argmin())
    return found[best] if ranks[best] <= _BETTER * ranks[0] else None


def _fits_to_all(
    body: MarkedBody, state: Poses, clouds: Sequence[Float[np.ndarray, "points 3"]], trials: range
) -> tuple[list[list[FoundBody]], Float[np.ndarray, " poses"]]:
    """Fits of a few poses to every cloud, and the mean rank of each pose.

    The state holds the first pose for each cloud, then the second pose for each, and so on.
    """
    count = len(clouds)
    cloud = np.arange(len(state.translation)) % count
    found = [one for _, one in _fits_of_poses(body, state, clouds, cloud, trials)]
    grouped = [found[k : k + count] for k in range(0, len(found), count)]
    return grouped, np.array([np.mean([one.rank for one in own]) for own in grouped])


def _likely_places(
    places: Float[np.ndarray, "poses markers 3"],
    points: Float[np.ndarray, "points 3"],
    effort: int,
) -> Int[np.ndarray, " chosen"]:
    """Return the numbers of the poses, centred on their markers, that lie nearest to points."""
    placed = places + np.median(points, 0)
    likely = np.argsort(_chamfer_distances(placed, points))[: _NEAR * effort]
    costs = np.array([points_assigned(one, points, _REACH[0])[1] for one in placed[likely]])
    return likely[np.argsort(costs)[: _TRIED * effort]]


def _largest_group(
    points: Float[np.ndarray, "points 3"],
) -> tuple[Float[np.ndarray, "some 3"], Bool[np.ndarray, " points"]]:
    """Return the largest group of points that is apart from all others, and a mask of it."""
    from scipy.cluster.hierarchy import fclusterdata

    group = fclusterdata(points, _APART, "distance") if len(points) > 1 else np.ones(len(points))
    names, counts = np.unique(group, return_counts=True)
    among = group == names[counts.argmax()]
    return points[among], among


def _fits_of_poses(
    body: MarkedBody,
    state: Poses,
    clouds: Sequence[Float[np.ndarray, "points 3"]],
    cloud: Int[np.ndarray, " poses"],
    trials: range = range(len(_REACH)),
) -> list[tuple[int, FoundBody]]:
    """Fit poses of one body to the points of clouds; return the best with their cloud's number.

    All are fitted at once, which takes hardly longer than one fit; worse ones are dropped.
    """
    for trial in trials:
        found = _assigned_clouds(body.places(state), clouds, cloud, _REACH[trial])
        if trial in _DROPS:
            kept = _cheaper_half(np.array([cost for _, cost in found]), cloud)
            state, cloud = state[torch.from_numpy(kept)], cloud[kept]
            found = [found[k] for k in kept.tolist()]
        shape = len(found), len(body.markers.labels)
        x, seen = np.zeros((*shape, 3)), np.zeros(shape, bool)
        for k, (marker, _) in enumerate(found):
            held = np.flatnonzero(marker >= 0)
            x[k, marker[held]], seen[k, marker[held]] = clouds[cloud[k]][held], True
        state = minimise_frames(body.energies(x, seen), state, _FEW).state
    found = _assigned_clouds(body.places(state), clouds, cloud, _REACH[-1])
    unusual = pose_density().coordinates(state.rotations[:, 1:]).square().mean(-1).tolist()
    return [
        (k, FoundBody(body, state[[row]], *found[row], unusual[row]))
        for row, k in enumerate(cloud.tolist())
    ]


def _assigned_clouds(
    places: Float[np.ndarray, "poses markers 3"],
    clouds: Sequence[Float[np.ndarray, "points 3"]],
    cloud: Int[np.ndarray, " poses"],
    reach: float,
) -> list[tuple[Int[np.ndarray, " points"], float]]:
    """Assign the markers of every pose to the points of its cloud, as `points_assigned` does."""
    return [points_assigned(one, clouds[k], reach) for one, k in zip(places, cloud, strict=True)]


def _cheaper_half(
    costs: Float[np.ndarray, " poses"], cloud: Int[np.ndarray, " poses"]
) -> Int[np.ndarray, " kept"]:
    """Return the numbers of the poses with the lower half of each cloud's costs, ascending."""
    kept = list[int]()
    for k in np.unique(cloud):
        own = np.flatnonzero(cloud == k)
        kept += own[np.argsort(costs[own])[: -(-len(own) // 2)]].tolist()
    return np.array(sorted(kept))


def points_assigned(
    places: Float[np.ndarray, "markers 3"], points: Float[np.ndarray, "points 3"], reach: float
) -> tuple[Int[np.ndarray, " points"], float]:
    """Assign points to markers by least squares; return markers (-1 beyond `reach`), mean cost."""
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
    """Return capped mean squared distances from places to nearest points and back (m²)."""
    a, b = torch.from_numpy(places).float(), torch.from_numpy(points).float()
    away = torch.cdist(a, b.expand(len(a), *b.shape)).clamp(max=_REACH[0]).square()
    return (away.amin(1).mean(-1) + away.amin(2).mean(-1)).numpy()
