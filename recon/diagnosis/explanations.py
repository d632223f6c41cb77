"""What may be wrong with one camera of several: each explanation undone, to see what remains."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float

from recon.core import rotations as so3
from recon.diagnosis.images import Images
from recon.diagnosis.rays import Rays, by_turn, derivatives, in_camera, projected

Cause = Literal["clock", "turned", "placed", "mirrored", "sized", "moving"]

_LATEST = 0.7
"""Seconds by which a clock may be off; what is further off is another recording."""
_LEAST_OVERLAP = 0.5
"""Share of the moments that views must share after a shift of the clock."""
_SAME_SIZE = 1.1
"""Factor below which an image has the size of its calibration; what else looks so is a turn."""
_SMOOTHING = 0.15
"""Seconds to either side over which the pose of a camera that moves is averaged."""
_ROUNDS = 8
_MIN_POINTS = 4
"""Points of a moment that tell how a camera is turned at that moment."""


@dataclass(frozen=True)
class Explained:
    """One view after an explanation was undone."""

    cause: Cause
    images: Images
    """All views; the one at odds as it should have been."""
    value: float
    """Seconds, degrees or factor, by cause; metres for a placed camera."""
    remains: float
    """Median distance of the view's rays from the points of the other views, metres."""


@dataclass(frozen=True)
class Odd:
    """A view beside what the others see."""

    images: Images
    view: int
    points: Float[np.ndarray, "moments points 3"]
    """Triangulated from the other views."""
    exists: Bool[np.ndarray, "moments points"]

    @classmethod
    def of(cls, images: Images, view: int) -> "Odd":
        """The points that the other views see."""
        rest = [v for v in range(len(images.names)) if v != view]
        points, exists = Rays.of(images.view(rest)).meet()
        return cls(images, view, points, exists)

    def miss(self, images: Images | None = None) -> float:
        """Median distance of the view's rays from the points of the others, metres."""
        one = Rays.of((self.images if images is None else images).view([self.view]))
        there = self.exists & (one.weight[0] > 0)
        return float(np.median(one.miss(self.points)[0][there])) if there.any() else 0.0

    def explained(self, causes: tuple[Cause, ...]) -> list[Explained]:
        """What remains after each of some explanations, the simplest first."""
        undone: dict[Cause, Callable[[], tuple[Images, float]]] = {
            "mirrored": self._mirrored,
            "clock": self._clock,
            "turned": self._turned,
            "sized": self._sized,
            "placed": self._placed,
            "moving": self._moving,
        }
        out: list[Explained] = []
        for cause in causes:
            images, value = undone[cause]()
            out.append(Explained(cause, images, value, self.miss(images)))
        return out

    def _mirrored(self) -> tuple[Images, float]:
        return mirrored(self.images, [self.view]), 0.0

    def _clock(self) -> tuple[Images, float]:
        """The shift in time that fits best, to a part of a frame (a parabola through three)."""
        images, moments = self.images, self.images.pixels.shape[1]
        most = min(round(_LATEST * images.fps), int((1 - _LEAST_OVERLAP) * moments))
        steps = np.arange(-most, most + 1)
        away = np.array([self.miss(shifted(images, self.view, float(s))) for s in steps])
        k = int(away.argmin())
        shift = float(steps[k])
        if 0 < k < len(steps) - 1 and (bend := away[k - 1] - 2 * away[k] + away[k + 1]) > 0:
            between = shift + 0.5 * (away[k - 1] - away[k + 1]) / bend
            if self.miss(shifted(images, self.view, between)) < away[k]:
                shift = between
        return shifted(images, self.view, shift), shift / images.fps

    def _directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays in the camera's frame, ways to the points, and where both exist."""
        one = Rays.of(self.images.view([self.view]))
        turn = self.images.pose[self.view, :, :3, :3]
        ways = self.points - one.origin[0]
        ways = ways / np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-9)
        local = np.swapaxes(turn, -1, -2)
        return one.direction[0] @ local, ways @ local, self.exists & (one.weight[0] > 0)

    def _turned(self) -> tuple[Images, float]:
        """The camera turned about itself, so that most rays meet the points (Wahba, robust)."""
        rays, ways, there = self._directions()
        turn = robust_turns(ways[there][None], rays[there][None], there[there][None])[0]
        return self._with_turn(np.broadcast_to(turn, (len(rays), 3, 3))), angle(turn)

    def _moving(self) -> tuple[Images, float]:
        """The camera turned about itself by an angle that changes, averaged over a while."""
        rays, ways, there = self._directions()
        moments = len(rays)
        known = there.sum(-1) >= _MIN_POINTS
        if not known.any():
            return self.images, 0.0
        vectors = rotation_vector(robust_turns(ways, rays, there))
        times = np.arange(moments)
        vectors = np.stack(
            [np.interp(times, times[known], vectors[known, k]) for k in range(3)], -1
        )
        smooth = averaged(vectors, round(_SMOOTHING * self.images.fps))
        spread = np.linalg.norm(smooth - smooth.mean(0), axis=-1).max()
        return self._with_turn(matrix_of(smooth)), float(np.degrees(spread))

    def _with_turn(self, turns: Float[np.ndarray, "moments 3 3"]) -> Images:
        pose = self.images.pose.copy()
        pose[self.view, :, :3] = turns @ pose[self.view, :, :3]
        fixed = np.ptp(pose[self.view], axis=0).max() < 1e-9
        kept = tuple(bool(fixed) if v == self.view else f for v, f in enumerate(self.images.fixed))
        return replace(self.images, pose=pose, fixed=kept)

    def _sized(self) -> tuple[Images, float]:
        """The image enlarged about its corner: detections of another resolution."""
        images, v = self.images, self.view
        local, front = in_camera(images.pose[v], self.points)
        pixels = projected(images.view([v]), local[None], front[None])[0]
        there = self.exists & front & images.seen[v]
        own = images.pixels[v][there]
        if len(own) == 0:
            return images, 1.0
        factor = float(np.median((pixels[there] * own).sum(-1) / np.square(own).sum(-1)))
        if 1 / _SAME_SIZE < factor < _SAME_SIZE:
            return images, 1.0
        scaled = images.pixels.copy()
        scaled[v] *= factor
        return replace(images, pixels=scaled), 1 / factor if factor > 0 else np.inf

    def _placed(self) -> tuple[Images, float]:
        """The camera at another place and turned (PnP: Gauss-Newton, robust, from `_turned`)."""
        images, _ = self._turned()
        pose = images.pose[self.view]
        rays, _, there = self._directions()
        plane = rays[..., :2] / np.where(rays[..., 2:] > 0.05, rays[..., 2:], np.inf)
        for _ in range(_ROUNDS):
            local, front = in_camera(pose, self.points)
            good = there & front & (rays[..., 2] > 0.05)
            if good.sum() < 12:
                return images, 0.0
            step = _pose_step(local[good], plane[good])
            turn = matrix_of(step[:3])
            pose = pose.copy()
            pose[:, :3] = turn @ pose[:, :3]
            pose[:, :3, 3] += step[3:]
        moved = np.linalg.norm(centre(pose[0]) - centre(self.images.pose[self.view, 0]))
        every = images.pose.copy()
        every[self.view] = pose
        return replace(images, pose=every), float(moved)


def mirrored(images: Images, views: list[int]) -> Images:
    """Left and right of some images exchanged."""
    pixels = images.pixels.copy()
    for v in views:
        pixels[v, ..., 0] = np.where(images.seen[v], images.size[v][0] - pixels[v, ..., 0], 0.0)
    return replace(images, pixels=pixels)


def shifted(images: Images, view: int, frames: float) -> Images:
    """One view as it would be if every moment showed what came so many frames later."""
    moments = images.pixels.shape[1]
    times = np.arange(moments) + frames
    low = np.floor(times + 1e-9).astype(int)
    part = (times - low)[:, None]
    part = np.where(np.abs(part) < 1e-6, 0.0, part)
    inside = (low >= 0) & (low + (part[:, 0] > 0) < moments)
    a, b = np.clip(low, 0, moments - 1), np.clip(low + 1, 0, moments - 1)
    pixels, confidence = images.pixels.copy(), images.confidence.copy()
    own, sure = images.pixels[view], images.confidence[view]
    both = np.where(part > 0, np.minimum(sure[a], sure[b]), sure[a])
    confidence[view] = np.where(inside[:, None], both, 0.0)
    there = confidence[view][..., None] > 0
    pixels[view] = np.where(there, (1 - part[..., None]) * own[a] + part[..., None] * own[b], 0.0)
    return replace(images, pixels=pixels, confidence=confidence)


def robust_turns(
    ways: Float[np.ndarray, "moments samples 3"],
    rays: Float[np.ndarray, "moments samples 3"],
    there: Bool[np.ndarray, "moments samples"],
) -> Float[np.ndarray, "moments 3 3"]:
    """The rotations that bring unit vectors onto others; those far off count less."""
    weight = there.astype(np.float64)
    turns = np.broadcast_to(np.eye(3), (len(ways), 3, 3))
    for _ in range(_ROUNDS):
        u, _, vh = np.linalg.svd(np.einsum("tn,tni,tnj->tij", weight, rays, ways))
        proper = np.ones((len(ways), 1, 3))
        proper[..., 0, 2] = np.linalg.det(u @ vh)
        turns = (u * proper) @ vh
        away = np.linalg.norm(rays - ways @ np.swapaxes(turns, -1, -2), axis=-1)
        usual = [np.median(a[s]) if s.any() else 1.0 for a, s in zip(away, there, strict=True)]
        weight = there / (1 + np.square(away / np.maximum(usual, 1e-6)[:, None]))
    return turns


def _pose_step(
    local: Float[np.ndarray, "samples 3"], plane: Float[np.ndarray, "samples 2"]
) -> Float[np.ndarray, "6"]:
    """A Gauss-Newton step of turn and shift in the camera's frame, with robust weights."""
    by_place = derivatives(local, np.ones(len(local), dtype=bool))
    jacobian = np.concatenate((by_place @ by_turn(local), by_place), -1)
    away = plane - local[:, :2] / local[:, 2:]
    size = np.linalg.norm(away, axis=-1)
    weight = 1 / (1 + np.square(size / max(float(np.median(size)), 1e-9)))
    weighted = jacobian * weight[:, None, None]
    normal = np.einsum("nki,nkj->ij", weighted, jacobian) + 1e-9 * len(local) * np.eye(6)
    return np.linalg.solve(normal, np.einsum("nki,nk->i", weighted, away))


def averaged(
    values: Float[np.ndarray, "moments dims"], reach: int
) -> Float[np.ndarray, "moments dims"]:
    """Means over as many moments to either side, fewer at the ends: straight lines stay."""
    moments = len(values)
    out = np.empty_like(values)
    for t in range(moments):
        here = min(reach, t, moments - 1 - t)
        out[t] = values[t - here : t + here + 1].mean(0)
    return out


def angle(turn: Float[np.ndarray, "3 3"]) -> float:
    """Angle of a rotation, degrees."""
    return float(np.degrees(np.linalg.norm(rotation_vector(turn))))


def rotation_vector(turn: Float[np.ndarray, "*shape 3 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Axis times angle, radians."""
    return so3.log(torch.from_numpy(np.ascontiguousarray(turn))).numpy()


def matrix_of(vector: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3 3"]:
    """The rotation of a vector: axis times angle, radians."""
    return so3.exp(torch.from_numpy(np.ascontiguousarray(vector))).numpy()


def centre(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """Where a camera stands in the recording, metres, from T_camera_world."""
    return -pose[:3, :3].T @ pose[:3, 3]
