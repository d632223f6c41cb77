"""Tracked 3D points of one clip, each with a name and a bone, and distances between them."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Bool, Float

from observations.points import TrackedPoints
from recon.body.model import BodyModel
from recon.core.skeleton import MIRROR, PARENTS
from recon.method.protocols import Estimate
from recon.method.timing import at_observation_times

_MAX_MIRROR_ERROR_M = 0.04
"""Distance (m) between a point's mirror image at rest and its counterpart on the other side;
markers are not placed more alike than this."""
_MIN_PAIR_LENGTH_M = 0.1
"""Distance (m) at rest from which on a pair of points is used for the size of a body."""
_MIN_PAIRS, _MIN_MOMENTS = 4, 3
_MAX_SPREAD_RATIO = 0.5
"""Variation of a bone's length, as a share of its error, up to which the error is constant."""


@dataclass(frozen=True)
class NamedPoints:
    """Positions of the named points of one clip, as arrays for the checks."""

    positions: Float[np.ndarray, "moments points 3"]
    """Positions in the recording's frame (m); zero where not visible."""
    visible: Bool[np.ndarray, "moments points"]
    names: tuple[str, ...]
    bones: tuple[int, ...]
    """Index of the body joint whose bone carries each point."""
    rest: Float[np.ndarray, "points 3"]
    """Positions of the points on the average body in its rest pose, metres."""
    fps: float
    given: TrackedPoints
    """The observation that the points come from."""
    are_joints: bool
    """Whether the points are joints and keypoints rather than markers on the skin."""
    rigid: tuple[tuple[int, int], ...] | None = None
    """Pairs of points whose distance no pose changes; None where they follow from `bones`."""
    std: Float[np.ndarray, "moments points"] | None = None
    """Standard deviation of the coordinates, metres; None where none are given."""

    @classmethod
    def of(cls, observation: TrackedPoints, body: BodyModel) -> "NamedPoints":
        """Take the points of a sensor with one clip, without the batch axis."""
        return cls(
            positions=observation.positions[0].double().numpy(),
            visible=observation.visible[0].numpy(),
            names=observation.point_names(body),
            bones=observation.bones(body),
            rest=observation.at_rest(body).double().numpy(),
            fps=observation.fps,
            given=observation,
            are_joints=not observation.on_skin,
            rigid=observation.rigid_pairs(body),
            std=None if observation.std is None else observation.std[0].double().numpy(),
        )

    @property
    def observation(self) -> TrackedPoints:
        """The sensor's observation with these positions; zero where not visible."""
        positions = self.positions * self.visible[..., None]
        std = None if self.std is None else torch.from_numpy(self.std.copy())[None]
        return self.given.replace(
            positions=torch.from_numpy(positions)[None].to(self.given.positions),
            visible=torch.from_numpy(self.visible.copy())[None],
            std=std,
        )

    def without(self, hidden: Bool[np.ndarray, "moments points"]) -> "NamedPoints":
        """Return the points with some of them marked as not visible."""
        return replace(self, visible=self.visible & ~hidden)

    def swapped(
        self, pair: tuple[int, int], moments: Bool[np.ndarray, " moments"]
    ) -> "NamedPoints":
        """Return the points with the positions of two points exchanged in some frames."""
        order = list(range(len(self.names)))
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        return self.permuted(tuple(order), moments)

    def permuted(
        self, order: tuple[int, ...], moments: Bool[np.ndarray, " moments"]
    ) -> "NamedPoints":
        """Return the points where, in some frames, point k gets the position of point order[k]."""
        index, when = list(order), moments[:, None]
        return replace(
            self,
            positions=np.where(when[..., None], self.positions[:, index], self.positions),
            visible=np.where(when, self.visible[:, index], self.visible),
            std=None if self.std is None else np.where(when, self.std[:, index], self.std),
        )

    @property
    def counterparts(self) -> tuple[int, ...]:
        """Index of every point's left-right counterpart; its own index if it has none.

        Joints and landmarks of the bundled body come in pairs, as the rest pose is symmetric.
        """
        central = [k for k, bone in enumerate(self.bones) if MIRROR[bone] == bone]
        image = self.rest * np.array([-1.0, 1.0, 1.0])
        image[:, 0] += 2 * float(np.median(self.rest[central, 0])) if central else 0.0
        away = np.linalg.norm(image[:, None] - self.rest[None], axis=-1)
        bones_match = np.array([[MIRROR[a] == b for b in self.bones] for a in self.bones])
        away[~bones_match] = np.inf
        nearest = away.argmin(1)
        return tuple(
            int(j) if away[k, j] < _MAX_MIRROR_ERROR_M and nearest[j] == k else k
            for k, j in enumerate(nearest)
        )

    @property
    def centre(self) -> Float[np.ndarray, "moments 3"]:
        """Median of the visible points in every frame (m); NaN where there is none."""
        there = np.any(self.visible, axis=1, keepdims=True)
        shown = np.where(self.visible[..., None], self.positions, np.nan)
        middle = np.nanmedian(np.where(there[..., None], shown, 0.0), axis=1)
        return np.where(there, middle, np.nan)


@dataclass(frozen=True)
class PredictedPoints:
    """Observed named points, their positions on the fitted body, and the differences."""

    points: NamedPoints
    positions: Float[np.ndarray, "moments points 3"]
    """Positions (m) on the fitted body, in the recording's frame; beyond the body's frames those
    of the nearest one."""
    away: Float[np.ndarray, "moments points"]
    """Distance (m) of every visible point from its place on the body; NaN where not visible."""
    typical: Float[np.ndarray, " points"]
    """Median of `away` over time (m); zero for points that were never seen."""
    offset: Float[np.ndarray, "points 3"]
    """Median offset (m) of each point from its place, in its bone's frame; zero if never seen."""
    spread: Float[np.ndarray, " points"]
    """Median distance (m) of the offsets in single frames from the median offset."""

    @classmethod
    def of(
        cls, points: NamedPoints, observed: TrackedPoints, estimate: Estimate
    ) -> "PredictedPoints":
        """Compute the points' places on the estimated body in the observation's frames."""
        moments = observed.positions.shape[-3]
        with torch.no_grad():
            there, seen = at_observation_times(
                estimate.scene.to_recording(observed.predicted(estimate)), estimate.motion,
                fps=observed.fps, start_time=observed.start_time, moments=moments,
            )  # fmt: skip
        covered = np.clip(np.arange(moments) - seen.start, 0, seen.stop - seen.start - 1)
        turns = estimate.body.orientations[0][:, list(points.bones)].double().numpy()
        frames = np.linspace(0, len(turns) - 1, seen.stop - seen.start).round().astype(int)
        positions = there[0].double().numpy()[covered]
        ways = np.where(points.visible[..., None], points.positions - positions, np.nan)
        known = np.where(np.any(points.visible, axis=0)[:, None], ways, 0.0)
        local = np.einsum("tpij,tpi->tpj", turns[frames[covered]], known)
        offset = np.nanmedian(local, axis=0)
        return cls(
            points=points,
            positions=positions,
            away=np.linalg.norm(ways, axis=-1),
            typical=np.nanmedian(np.linalg.norm(known, axis=-1), axis=0),
            offset=offset,
            spread=np.nanmedian(np.linalg.norm(local - offset, axis=-1), axis=0),
        )


def relative_body_size(points: NamedPoints) -> float | None:
    """Return the body's size relative to the average: median ratio of distances along bones.

    None where too few such distances are seen.
    """
    pairs = {*joint_pairs(points), *(() if points.rigid else same_bone_pairs(points))}
    ratios = [
        float(np.median(seen)) / rest
        for a, b in sorted(pairs)
        if (rest := rest_length(points, a, b)) > _MIN_PAIR_LENGTH_M
        and len(seen := distances(points, a, b)) >= _MIN_MOMENTS
    ]
    return float(np.median(ratios)) if len(ratios) >= _MIN_PAIRS else None


def joints_of_impossible_bones(points: NamedPoints, limit: float) -> Bool[np.ndarray, " points"]:
    """Return a mask of joints whose bones to all neighbours have lengths that no person has.

    Args:
        points: joints; for markers the mask is false.
        limit: error (m) of the median length of each bone, against the average body scaled to
            the same size, above which it is implausible.
    """
    wrong: list[list[bool]] = [[] for _ in points.names]
    ratio = relative_body_size(points) or 0.0
    for a, b in joint_pairs(points) if ratio and points.are_joints else ():
        seen = distances(points, a, b)
        if len(seen) >= _MIN_MOMENTS:
            middle = float(np.median(seen))
            error = abs(middle - ratio * rest_length(points, a, b))
            spread = float(np.median(np.abs(seen - middle)))
            for one in (a, b):
                wrong[one].append(error > limit and spread < _MAX_SPREAD_RATIO * error)
    # a joint is wrong if all of its bones are: one bone of plausible length shows it to be right
    return np.array([len(bones) > 0 and all(bones) for bones in wrong])


def joint_pairs(points: NamedPoints) -> list[tuple[int, int]]:
    """Return pairs of joints at the ends of each bone, parent first; or the given rigid pairs."""
    if points.rigid is not None:
        return list(points.rigid)
    bones = list(enumerate(points.bones))
    return [(a, b) for b, child in bones for a, bone in bones if PARENTS[child] == bone]


def same_bone_pairs(points: NamedPoints) -> list[tuple[int, int]]:
    """Return pairs of points that lie on the same bone."""
    return [(a, b) for a, b in combinations(range(len(points.bones)), 2)
            if points.bones[a] == points.bones[b]]  # fmt: skip


def distances(points: NamedPoints, a: int, b: int) -> Float[np.ndarray, " moments"]:
    """Return distances (m) between two points in the frames where both are seen."""
    both = points.visible[:, a] & points.visible[:, b]
    return np.linalg.norm(points.positions[both, a] - points.positions[both, b], axis=-1)


def rest_length(points: NamedPoints, a: int, b: int) -> float:
    """Return the distance (m) of two points on the average body in its rest pose."""
    return float(np.linalg.norm(points.rest[a] - points.rest[b]))
