"""Names the tracks of a recording by how the markers of a known set lie to each other."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.ingest.marker_distances import MarkerDistances, matched
from recon.ingest.marker_exchanges import mirrored

_FEWEST = 4
"""Named neighbours without which no track is named."""
_MARGIN = 4.0
"""Log odds by which a name must be likelier than the next and than none."""
_SAMPLES = 6
"""Frames of a track in which it is compared with the others."""
_LONG_S, _GAP_S = 3.0, 0.5
"""Seconds after which a track is no better for being longer, and of gaps that are bridged."""
_ROUNDS = 3


class Naming:
    """Assigns the markers of a set to the tracks of a recording, as far as they can be found."""

    def __init__(
        self,
        track: Int[np.ndarray, "time points"],
        positions: Float[np.ndarray, "time points 3"],
        fps: float,
        model: MarkerDistances,
    ) -> None:
        """Begin without names; `track` is -1 where a point is not visible."""
        self.track, self.positions, self.fps, self.model = track, positions, fps, model
        frames, points = np.nonzero(track >= 0)
        order = np.argsort(track[frames, points], kind="stable")
        self._frames, self._x = frames[order], positions[frames[order], points[order]]
        self._ends = np.append(0, np.cumsum(np.bincount(track[frames, points])))
        self.marker = np.full(len(self._ends) - 1, -1)
        self.margin = np.zeros(len(self.marker))
        """Log odds by which the name of a track is likelier than the next."""
        self._named = np.full((len(track), len(model.names), 3), np.nan)

    def run(self) -> None:
        """Name the frame that shows most, then its neighbours, and take doubtful names back."""
        self._begin()
        for _ in range(_ROUNDS):
            self._grow()
            if not self._doubted():
                return

    def _rows(self, track: int) -> slice:
        return slice(int(self._ends[track]), int(self._ends[track + 1]))

    def _name(self, track: int, marker: int) -> None:
        rows = self._rows(track)
        if (old := self.marker[track]) >= 0:
            self._named[self._frames[rows], old] = np.nan
        self.marker[track] = marker
        if marker >= 0:
            self._named[self._frames[rows], marker] = self._x[rows]

    def _begin(self) -> None:
        """Name the tracks of the frame that shows most."""
        life = np.minimum(np.diff(self._ends), _LONG_S * self.fps)
        key = int(np.where(self.track >= 0, life[self.track], 0.0).sum(1).argmax())
        here = self.track[key][self.track[key] >= 0]
        here = here[np.argsort(-life[here])][: 2 * len(self.model.names)]
        frames = np.unique(np.concatenate([self._frames[self._rows(k)] for k in here.tolist()]))
        frames = frames[np.linspace(0, len(frames) - 1, 60).astype(int)]
        x = self._at(np.append(frames, key), here)
        with np.errstate(invalid="ignore"):
            away = np.linalg.norm(x[:, :, None] - x[:, None], axis=-1)
        mean, variance = np.nanmean(away, 0), np.nanvar(away, 0)
        found = matched(self.model, mean, variance, x[-1:], opposite_markers(self.model.names))
        for track, marker in zip(here.tolist(), found.tolist(), strict=True):
            if marker >= 0:
                self._name(track, marker)

    def _at(
        self, frames: Int[np.ndarray, " frames"], tracks: Int[np.ndarray, " tracks"]
    ) -> Float[np.ndarray, "frames tracks 3"]:
        """Positions of some tracks in some frames; NaN where they are not."""
        place = np.full(len(self.marker) + 1, -1)
        place[tracks] = np.arange(len(tracks))
        rows, points = np.nonzero(place[self.track[frames]] >= 0)
        out = np.full((len(frames), len(tracks), 3), np.nan)
        out[rows, place[self.track[frames[rows], points]]] = self.positions[frames[rows], points]
        return out

    def _scores(self, track: int) -> Float[np.ndarray, " markers"]:
        """Log odds of every marker for a track, by the named markers around it."""
        rows, count = self._rows(track), len(self.model.names)
        pick = np.unique(np.linspace(rows.start, rows.stop - 1, _SAMPLES).astype(int))
        near = self._named[self._frames[pick]]
        if self.marker[track] >= 0:
            near[:, self.marker[track]] = np.nan
        away = np.linalg.norm(near - self._x[pick][:, None], axis=-1)
        j = np.flatnonzero(np.isfinite(away).any(0))
        if len(j) < _FEWEST:
            return np.full(count, -np.inf)
        i = np.arange(count)[:, None]
        odds = self.model.log_odds(np.nanmean(away[:, j], 0), np.nanvar(away[:, j], 0), i, j)
        places = self.model.odds_of_places(near, self._x[pick][:, None], np.array([-1]))[0]
        return np.where(i == j, 0.0, odds).sum(1) + places + self._continued(rows)

    def _continued(self, rows: slice) -> Float[np.ndarray, " markers"]:
        """Log odds of every marker by where it was before the track and is after it."""
        total, reach = np.zeros(len(self.model.names)), int(_GAP_S * self.fps)
        for own, step in ((rows.start, -1), (rows.stop - 1, 1)):
            frame, x = int(self._frames[own]), self._x[own]
            inner = own - step * min(2, rows.stop - rows.start - 1)
            velocity = (x - self._x[inner]) / max(1, abs(int(self._frames[inner]) - frame))
            side = frame + step * np.arange(1, reach + 1)
            side = side[(side >= 0) & (side < len(self._named))]
            if len(side) == 0:
                continue
            part = self._named[side]
            seen = np.isfinite(part[..., 0])
            row = seen.argmax(0)
            gap = (row + 1)[:, None]
            away = np.linalg.norm(part[row, np.arange(len(total))] - x - velocity * gap, axis=-1)
            time = gap[:, 0] / self.fps
            sigma = 0.008 + 0.2 * time + 10 * time**2
            odds = -0.5 * (away / sigma) ** 2 - np.log(15.75 * sigma**3)
            total += np.where(seen.any(0), np.logaddexp(odds, np.log(0.05)), 0.0)
        return total

    def _free(self, track: int) -> Bool[np.ndarray, " markers"]:
        """The markers that no other track is in the frames of this one."""
        return np.all(np.isnan(self._named[self._frames[self._rows(track)], :, 0]), axis=0)

    def _grow(self) -> None:
        """Name further tracks by those that are named, the surest first, until none is sure."""
        named = True
        while named:
            sure: list[tuple[float, int, int]] = []
            for track in np.flatnonzero(self.marker < 0).tolist():
                scores = np.where(self._free(track), self._scores(track), -np.inf)
                second, best = np.argsort(scores)[-2:].tolist()
                if (margin := float(scores[best] - max(0.0, scores[second]))) > _MARGIN:
                    sure.append((margin, track, best))
            named = False
            for margin, track, marker in sorted(sure, reverse=True):
                if self._free(track)[marker]:
                    self._name(track, marker)
                    self.margin[track], named = margin, True

    def _doubted(self) -> int:
        """Take back names that the markers around contradict, and return how many."""
        taken = 0
        for track in np.flatnonzero(self.marker >= 0).tolist():
            scores, own = self._scores(track), self.marker[track]
            scores[~self._free(track) & (np.arange(len(scores)) != own)] = -np.inf
            mine, scores[own] = float(scores[own]), 0.0
            self.margin[track] = mine - float(scores.max())
            if self.margin[track] < _MARGIN:
                self._name(track, -1)
                taken += 1
        return taken


def opposite_markers(names: Sequence[str]) -> Int[np.ndarray, " markers"]:
    """The marker of the other side of each: itself in the middle, -1 where it has none."""
    others = [mirrored(name) for name in names]
    pairs = enumerate(others)
    return np.array([names.index(o) if o in names else -1 if o else k for k, o in pairs])
