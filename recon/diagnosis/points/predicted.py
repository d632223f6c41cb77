"""Tracked points as predicted by a fitted body, beside their observed positions."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from observations.timing import at_observation_times
from recon.diagnosis.points.named_points import NamedPoints, Points
from recon.method.protocols import Estimate


@dataclass(frozen=True)
class Predicted:
    """Predicted and observed positions of points."""

    points: NamedPoints
    positions: Float[np.ndarray, "moments points 3"]
    """Predicted positions in the frame of the recording, metres; beyond the body's frames those of
    the nearest one."""
    turns: Float[np.ndarray, "moments points 3 3"]
    """Orientation of every point's bone."""

    @classmethod
    def of(cls, points: NamedPoints, observed: Points, estimate: Estimate) -> "Predicted":
        """The prediction of an estimate at the moments of the observation."""
        moments = observed.positions.shape[-3]
        with torch.no_grad():
            there, seen = at_observation_times(
                estimate.scene.to_recording(observed.predict(estimate)), estimate.motion,
                fps=observed.fps, start_time=observed.start_time, moments=moments,
            )  # fmt: skip
        covered = np.clip(np.arange(moments) - seen.start, 0, seen.stop - seen.start - 1)
        turns = estimate.body.orientations[0][:, list(points.bones)].double().numpy()
        frames = np.linspace(0, len(turns) - 1, seen.stop - seen.start).round().astype(int)
        return cls(points, there[0].double().numpy()[covered], turns[frames[covered]])

    @property
    def away(self) -> Float[np.ndarray, "moments points"]:
        """Distance of every visible point from its place, metres; NaN where not visible."""
        distance = np.linalg.norm(self.points.positions - self.positions, axis=-1)
        return np.where(self.points.visible, distance, np.nan)

    @property
    def typical(self) -> Float[np.ndarray, " points"]:
        """Median distance of every point, metres; zero for those never seen."""
        away = self.away.copy()
        away[:, ~self.points.visible.any(0)] = 0.0
        return np.nanmedian(away, axis=0)

    @property
    def offsets(self) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"]]:
        """Every point's median offset from its place, and how much single offsets differ from it.

        Both are in the frame of the point's bone, metres; the second is the median length of the
        differences. Zero for points that were never seen.
        """
        points = self.points
        away = np.where(points.visible[..., None], points.positions - self.positions, np.nan)
        away[:, ~points.visible.any(0)] = 0.0
        local = np.einsum("tpij,tpi->tpj", self.turns, away)
        middle = np.nanmedian(local, axis=0)
        return middle, np.nanmedian(np.linalg.norm(local - middle, axis=-1), axis=0)


def least_away(typical: Float[np.ndarray, " points"], at_least: float, times: float) -> float:
    """Median distance from which on a point is suspicious beside the others, metres."""
    known = typical[typical > 0]
    return max(at_least, times * float(np.median(known))) if len(known) > 0 else np.inf
