"""Assigns marker names to the tracks of a recording, by following a body model with markers.

The body's pose is found in one frame and followed from there, forwards and backwards: fitted to
the tracks named so far, the body predicts the position of every marker, and tracks are assigned to
markers anew. The log odds of each track's names are summed over frames. Finally the body, its
shape and the markers' offsets are fitted to all named tracks, and all are assigned once more.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np
import torch
from jaxtyping import Float, Int

from recon.core.struct import concatenate
from recon.ingest.marker_places import MarkedBody
from recon.ingest.marker_poses import Poses
from recon.ingest.marker_start import FoundBody, found_bodies, with_limb_turned
from recon.ingest.tied_frames import LevenbergMarquardt, minimise_frames
from recon.mocap.recording import MarkerRecording

_RATE, _BEGINNINGS, _CLOSELY = 10.0, 6, 2
"""Key frames per second in which the body is posed; number of frames in which it is searched at
first; and of those among them, fitted best, in which unusual poses are tried."""
_GOOD, _GOOD_PER_METRE, _TOLERABLE = 0.12, 2.4, 1.2
"""Rank (see `FoundBody.rank`) below which a body is accepted at once; its increase per metre of
standard deviation of the markers; and its multiple below which unusual poses are not tried."""
_SURE, _ROUNDS, _CALIBRATING, _ABOUT = 0.03, 2, 24, 4
"""Standard deviation (m) below which marker offsets count as known; rounds and number of frames of
their calibration; and key frames on both sides of the first that the first calibration uses."""
_COMPARED, _TURNED = 4, 3
"""Frames in which turns of limbs are compared, and how often the body is followed at most."""
_NOWHERE = 0.35
"""Cost (see `FoundBody.cost`) above which no body is found, and nothing is named."""
_LEAST, _ODDS = -4.0, 2.0
"""Lower limit of one frame's log odds for a name, and log odds that a track needs to be named."""
_FEWEST, _RENAMED = 4, 0.1
"""Least number of named markers to which a pose is fitted in a frame, and the share of its points
with new names above which it is fitted once more."""
_WEIGHT = 8.0
"""Number of frames beyond which a longer track does not count more."""
_FIT = LevenbergMarquardt(max_iterations=8, tolerance=1e-2, damping=1e-3)
_FOLLOW = LevenbergMarquardt(max_iterations=3, tolerance=3e-2, damping=1e-3)
"""How a pose is fitted to named markers, and from its neighbour's pose while names are found."""


class Naming:
    """Assigns marker names to the tracks of a recording; the result is in `marker`, `margin`."""

    def __init__(
        self,
        seen: MarkerRecording,
        track: Int[np.ndarray, "time points"],
        bodies: list[MarkedBody],
    ) -> None:
        """Begin with unnamed tracks; `track` is each point's track number, -1 where hidden."""
        self.seen, self.track, self.bodies = seen, track, bodies
        count = round(seen.frames / seen.fps * _RATE)
        keys = np.unique(np.linspace(0, seen.frames - 1, max(2, count)).astype(int))
        self.keys = keys[(track[keys] >= 0).any(1)]
        shape = int(track.max()) + 1, len(bodies[0].markers.labels)
        self.marker = np.full(shape[0], -1)
        self.margin = np.zeros(shape[0])
        """Log odds of every track's name, less those of its next likely name."""
        self._sum, self._count = np.zeros(shape), np.zeros(shape[0])

    def name_all_tracks(self) -> None:
        """Find the body, follow and fit it, and name the tracks; without a body none is named."""
        found, at = self._first_body()
        if found.cost > _NOWHERE:
            return
        usual_spread, spread = found.body.usual_spread, found.body.spread
        every = np.arange(len(self.keys))
        if usual_spread > _SURE:  # first calibrate shape and offsets in frames near `at`
            near = every[max(0, at - _ABOUT) : at + _ABOUT + 1]
            self._follow_and_turn(found, at, near)
            self._name_tracks()
            body = self._calibrated_body(found.body, near)
            pose = body.posed(self._translation[[at]], self._rotations[[at]])
            found = replace(found, body=body, pose=pose)
        body = found.body
        self._follow_and_turn(found, at, every)
        self._name_tracks()
        if usual_spread > _SURE:
            # better names give better offsets of this person's markers, which give better names
            for _ in range(_ROUNDS):
                former = self.marker.copy()
                body = self._calibrated_body(body, every)
                table = replace(body, offsets=body.markers.nominal, spread=spread)
                self._sum_log_odds_again(body, table)
                self._name_tracks()
                if (self.marker == former).all():
                    break
            else:
                body = self._calibrated_body(body, every)
        self._sum_log_odds_again(body, body)
        self._name_tracks()

    def _first_body(self) -> tuple[FoundBody, int]:
        """Search for the body in a few key frames; return the best fit and its frame's number."""
        counts = (self.track[self.keys] >= 0).sum(1)
        parts = np.array_split(np.arange(len(self.keys)), min(_BEGINNINGS, len(self.keys)))
        fullest = [int(part[counts[part].argmax()]) for part in parts]
        # try first an early frame, in which people mostly stand, together with a middle one
        starts = [fullest.pop(0), *fullest[len(fullest) // 2 :][:1]]
        others = [k for k in fullest if k not in starts]
        found: list[tuple[FoundBody, int]] = []
        for some, effort, least in ((starts, 1, 1.0), (others, 1, _TOLERABLE), (None, 3, np.inf)):
            some = [at for _, at in found[:_CLOSELY]] if some is None else some
            if some:
                clouds = [self._points_and_tracks(k)[0] for k in some]
                found += zip(found_bodies(clouds, self.bodies, effort), some, strict=True)
                found.sort(key=lambda one: self._misfit(*one))
            if self._misfit(*found[0]) < least:
                break
        return found[0]

    def _misfit(self, found: FoundBody, at: int) -> float:
        """Return a found body's rank divided by the rank below which it is accepted at once.

        Where points have names of the set, as in a trial that is named like itself, the share of
        those that disagree is added: most are right, while a limb put on wrongly has a good rank.
        """
        numbers = {name: k for k, name in enumerate(self.bodies[0].markers.labels)}
        given = np.array([numbers.get(name, -1) for name in self.seen.marker_names])
        named = given[self.track[self.keys[at]] >= 0]
        both = (named >= 0) & (found.marker >= 0)
        against = float((named != found.marker)[both].mean()) if both.any() else 0.0
        return (found.rank + against) / (_GOOD + _GOOD_PER_METRE * found.body.usual_spread)

    def _points_and_tracks(self, at: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (m) and track numbers of the visible points of a key frame."""
        frame = self.keys[at]
        shown = self.track[frame] >= 0
        return self.seen.positions[frame, shown], self.track[frame, shown]

    def _follow_and_turn(self, found: FoundBody, at: int, keys: Int[np.ndarray, " keys"]) -> None:
        """Follow the body through key frames; repeat while turning a limb improves the fit."""
        some = [
            int(part[(self.track[self.keys[part]] >= 0).sum(1).argmax()])
            for part in np.array_split(keys, min(_COMPARED, len(keys)))
        ]
        clouds = [self._points_and_tracks(k)[0] for k in some]
        for turns_left in reversed(range(_TURNED)):
            self._sum[:], self._count[:] = 0.0, 0.0
            self._follow_body(found, at, keys)
            poses = found.body.posed(self._translation[some], self._rotations[some])
            turned = with_limb_turned(found.body, poses, clouds) if turns_left else None
            if turned is None:
                break
            found, at = min(zip(turned, some, strict=True), key=lambda one: one[0].rank)

    def _follow_body(self, found: FoundBody, at: int, keys: Int[np.ndarray, " keys"]) -> None:
        """Fit poses from one key frame onwards, and sum the log odds of the tracks' names."""
        body = found.body
        kept = [found.pose] * len(self.keys)
        pairs = zip_longest(keys[keys > at].tolist(), keys[keys < at][::-1].tolist())
        for some in ([at], *([k for k in both if k is not None] for both in pairs)):
            # fit up to two frames at once, as fast as one; each starts at its neighbour's pose
            pose = concatenate([kept[k - int(np.sign(k - at))] for k in some])
            points, tracks = zip(*(self._points_and_tracks(k) for k in some), strict=True)
            known = [self._markers_of_points(self._mean_log_odds(own)) for own in tracks]
            if some != [at]:  # fit the tracks named so far, before naming others
                pose = _fit_poses(body, pose, points, known)
            said = _log_odds_of_points(body, pose, points)
            held = [
                self._markers_of_points(self._mean_log_odds(own) + new)
                for own, new in zip(tracks, said, strict=True)
            ]
            if any((a != b).mean() > _RENAMED for a, b in zip(held, known, strict=True)):
                pose = _fit_poses(body, pose, points, held)
                said = _log_odds_of_points(body, pose, points)
            for row, k in enumerate(some):
                kept[k] = pose[[row]]
                self._sum[tracks[row]] += said[row]
                self._count[tracks[row]] += 1
        every = concatenate(kept)
        self._translation, self._rotations = every.translation, every.rotations

    def _calibrated_body(self, body: MarkedBody, keys: Int[np.ndarray, " keys"]) -> MarkedBody:
        """Return the body with shape and marker offsets fitted to named markers of key frames."""
        x, seen = self.named_points(self.keys)
        parts = np.array_split(keys, min(_CALIBRATING, len(keys)))
        some = np.array([part[seen[part].sum(1).argmax()] for part in parts])
        poses = body.posed(self._translation[some], self._rotations[some])
        return body.calibrated(x[some], seen[some], poses)

    def _mean_log_odds(
        self, tracks: Int[np.ndarray, " points"]
    ) -> Float[np.ndarray, "points markers"]:
        """Return mean log odds of every marker for some tracks, weighted by their lengths."""
        count = self._count[tracks][:, None]
        return self._sum[tracks] / np.maximum(count, 1) * np.minimum(count, _WEIGHT)

    @staticmethod
    def _markers_of_points(
        odds: Float[np.ndarray, "points markers"],
    ) -> Int[np.ndarray, " points"]:
        from scipy.optimize import linear_sum_assignment

        rows, columns = linear_sum_assignment(-np.maximum(odds, 0.0))
        marker = np.full(len(odds), -1)
        good = odds[rows, columns] > 0
        marker[rows[good]] = columns[good]
        return marker

    def _name_tracks(self) -> None:
        """Name each track by the marker to which it is assigned in most key frames."""
        every = np.arange(len(self.marker))
        total = self._mean_log_odds(every)
        votes = np.zeros_like(total)
        for k in range(len(self.keys)):
            tracks = self._points_and_tracks(k)[1]
            marker = self._markers_of_points(total[tracks])
            votes[tracks[marker >= 0], marker[marker >= 0]] += 1
        frames = self._frames_of_tracks()
        taken = np.zeros((self.seen.frames, total.shape[1]), bool)
        self.marker[:], self.margin[:] = -1, 0.0
        score = np.where(votes > 0, votes, -np.inf) + 1e-3 * total
        for track in np.argsort(-score.max(1)).tolist():
            if self._count[track] == 0:
                continue
            free = ~np.any(taken[frames[track]], axis=0)
            own = np.where(free, total[track], -np.inf)
            best = int(np.where(free, score[track], -np.inf).argmax())
            if not free[best] or votes[track, best] == 0:
                best = int(own.argmax())
            others = np.delete(own, best)
            margin = float(own[best] - max(0.0, others.max(initial=-np.inf)))
            if own[best] > _ODDS and margin > _ODDS:
                self.marker[track], self.margin[track] = best, margin
                taken[frames[track], best] = True

    def _frames_of_tracks(self) -> list[np.ndarray]:
        rows, points = np.nonzero(self.track >= 0)
        numbers = self.track[rows, points]
        order = np.argsort(numbers, kind="stable")
        ends = np.cumsum(np.bincount(numbers, minlength=len(self.marker)))[:-1]
        return np.split(rows[order], ends)

    def named_points(self, frames: Int[np.ndarray, " frames"]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (m) of named markers in some frames, and a mask of those visible."""
        shape = len(frames), self._sum.shape[1]
        x, seen = np.zeros((*shape, 3)), np.zeros(shape, bool)
        rows, points = np.nonzero(self.track[frames] >= 0)
        marker = self.marker[self.track[frames[rows], points]]
        rows, points, marker = rows[marker >= 0], points[marker >= 0], marker[marker >= 0]
        x[rows, marker], seen[rows, marker] = self.seen.positions[frames[rows], points], True
        return x, seen

    def _sum_log_odds_again(self, body: MarkedBody, scored: MarkedBody) -> None:
        """Fit poses of `body` to named markers; sum log odds anew by the markers of `scored`."""
        from scipy.interpolate import CubicSpline

        x, seen = self.named_points(self.keys)
        poses = body.posed(self._translation, self._rotations)
        poses = minimise_frames(body.energies(x, seen), poses, _FIT).state
        self._translation, self._rotations = poses.translation, poses.rotations
        places = scored.places(poses)
        frames, numbers = self._sampled_tracks()
        path = CubicSpline(self.keys, places) if len(self.keys) > 3 else None
        self._sum[:], self._count[:] = 0.0, 0.0
        for frame in np.unique(frames).tolist():
            mine = numbers[frames == frame]
            place = path(frame) if path is not None else places[np.abs(self.keys - frame).argmin()]
            column = {int(t): p for p, t in enumerate(self.track[frame].tolist())}
            points = self.seen.positions[frame, [column[int(t)] for t in mine]]
            self._sum[mine] += _log_odds(points[:, None] - place, scored.spread)
            self._count[mine] += 1

    def _sampled_tracks(self) -> tuple[np.ndarray, np.ndarray]:
        """Draw a few frames of every track; return frame numbers and their track numbers."""
        frames, numbers = list[np.ndarray](), list[np.ndarray]()
        for track, own in enumerate(self._frames_of_tracks()):
            pick = own[np.unique(np.linspace(0, len(own) - 1, int(_WEIGHT)).astype(int))]
            frames.append(pick)
            numbers.append(np.full(len(pick), track))
        return np.concatenate(frames), np.concatenate(numbers)


def _fit_poses(
    body: MarkedBody,
    poses: Poses,
    points: Sequence[np.ndarray],
    markers: Sequence[Int[np.ndarray, " points"]],
) -> Poses:
    """Fit each pose to the points that are assigned to markers in its frame."""
    shape = len(points), len(body.markers.labels)
    x, seen = np.zeros((*shape, 3)), np.zeros(shape, bool)
    for row, (own, marker) in enumerate(zip(points, markers, strict=True)):
        held = np.flatnonzero(marker >= 0)
        if len(held) >= _FEWEST:
            x[row, marker[held]], seen[row, marker[held]] = own[held], True
    energies = replace(body.energies(x, seen), natural=poses.rotations[:, 1:])
    return minimise_frames(
        energies, poses, _FOLLOW, torch.from_numpy(np.flatnonzero(seen.any(1)))
    ).state


def _log_odds_of_points(
    body: MarkedBody, poses: Poses, points: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Return, for each frame, log odds that each point is each marker of the posed body."""
    return [
        _log_odds(own[:, None] - places, body.spread)
        for own, places in zip(points, body.places(poses), strict=True)
    ]


def _log_odds(
    away: Float[np.ndarray, "points markers 3"], spread: Float[np.ndarray, " markers"]
) -> Float[np.ndarray, "points markers"]:
    """Return log odds that points are markers (normal density), not strays (one per m³)."""
    near = -0.5 * (away**2).sum(-1) / spread**2 - np.log(15.75 * spread**3)
    return np.maximum(near, _LEAST)
