"""Corrects clock and pose of one camera by what the other views see (robust Gauss-Newton).

A view that is late by L shows at time t what happened at t - L; a camera that was moved after its
calibration is rotated about its centre and shifted a little. Both move keypoints in the image, so
neither can be estimated while the other is taken as right: of 80 ms and 1 degree, each alone
leaves half of the error. Here all seven unknowns are estimated at once. The derivative by the
clock is the velocity of the points.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation
from torch import Tensor

from recon.diagnosis.explanations import (
    camera_centre,
    robust_rotations,
    shifted_in_time,
)
from recon.diagnosis.images import Images
from recon.diagnosis.rays import (
    Trajectories,
    derivatives_by_rotation,
    derivatives_of_projection,
    in_camera,
    projected,
    ray_directions,
)
from recon.solver.banded import Banded
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise

Part = Literal["clock", "pose"]
"""The part of a view that may be wrong: the times of its frames, or the camera's pose."""

PARTS: tuple[Part, ...] = ("clock", "pose")

SHIFT = 0.01
"""Standard deviation (m) of every coordinate of the camera's shift, as of a tripod that was
pushed. A rotation by 1 degree moves what is seen at 4 m by 0.07 m."""
NOISE = 1.5
"""Residuals, as a multiple of the keypoints' noise, up to which nothing else is wrong."""
MAX_LATE_S = 0.7
"""Largest error of a clock (s)."""
_MIN_OVERLAP = 0.5
"""Share of its frames that a view must share with the others after a shift of its clock."""
COARSE_STEP_S = 1 / 30
"""Step (s) between the tested clock offsets, the best of which is refined."""
_MAX_FRAMES = 500
"""Largest number of frames that are used, evenly spread over a longer recording."""
_OPTIONS = GaussNewton(12, tolerance=1.4e-3, scale=1.0, damping=0.0)
"""Iterations end with a step of the seven unknowns of about 0.02 standard deviations each."""
_MIN_KEYPOINTS = 100
"""Least number of keypoints to estimate clock and pose from."""
_OUTLIER_SQUARED_STDS = 9.0
"""Squared residual, in standard deviations, at which a keypoint has half of its weight."""
_MEDIAN_SQUARED_LENGTH = 1.386
"""Median of the squared length of a vector of two independent standard normal numbers."""
_MAX_CLEAN_GAIN = 30.0
"""Predicted decrease of the squared residuals below which no correction is searched."""
_MAX_CLEAN_COST = 1.85
"""Mean robust squared residual above which a correction is searched anyway; white noise has
1.6."""
_MIN_MOTION_SHARE = 0.2
"""Share of the squared velocities that must be more than noise for a clock to be estimated."""
_MAX_RESIDUAL_RATIO = 0.97
"""Ratio of the residuals at a clock offset to those at one nearer to zero, to be preferred."""
_COARSE_FRAMES = 40
"""Number of frames from which the first clock offset is chosen."""
_UNKNOWN: dict[Part, slice] = {"clock": slice(0, 1), "pose": slice(1, 7)}


@dataclass(frozen=True)
class ViewCorrection:
    """The correction with which one view agrees with the others, and its uncertainty."""

    view: int
    late: float
    """Number of frames by which the view is late."""
    pose: Float[np.ndarray, "4 4"]
    """The corrected T_camera_world."""
    values: Float[np.ndarray, "7"]
    """Clock offset in frames, rotation vector about the camera's axes (rad), shift of its centre
    along them (m)."""
    covariance: Float[np.ndarray, "7 7"]
    """Covariance of `values`; zero for what was not corrected."""
    noise: float
    """Remaining residuals in standard deviations of white noise: 1 where nothing else is wrong."""
    cost: float
    """Robust sum of squared residuals, including those among the other views."""
    inflation: float
    """Number of residuals per independent one, as neighbouring residuals are correlated."""
    moves: float
    """Root mean square distance by which the correction moves keypoints, in standard deviations of
    their noise."""

    def squared_deviations(self, part: Part) -> float:
        """Return the squared size of one part of the correction, in standard deviations."""
        rows = _UNKNOWN[part]
        own, values = self.covariance[rows, rows], self.values[rows]
        return float(values @ np.linalg.solve(own, values)) if own.any() else 0.0

    @property
    def degrees(self) -> float:
        """Angle (degrees) of the correcting rotation."""
        return float(np.degrees(np.linalg.norm(self.values[1:4])))

    @property
    def metres(self) -> float:
        """Distance (m) by which the centre of the camera is shifted."""
        return float(np.linalg.norm(self.values[4:]))

    def applied_to(self, images: Images) -> Images:
        """Apply the correction to this view, and return all views."""
        pose = images.pose.copy()
        pose[self.view] = self.pose
        return shifted_in_time(replace(images, pose=pose), self.view, self.late)


_ClockAndPose = tuple[float, Float[np.ndarray, "4 4"]]
"""Number of frames by which a view is late, and its T_camera_world."""


@dataclass(frozen=True)
class ViewAlignment(Problem[_ClockAndPose]):
    """Residuals of a view against points that the others see, as a function of clock and pose."""

    images: Images
    """Keypoints and camera of the aligned view alone."""
    view: int
    paths: Trajectories
    sigma: float
    """Standard deviation of a pixel coordinate."""
    parts: tuple[Part, ...]
    frames: Float[np.ndarray, " moments"]
    """Numbers of the frames that are used."""

    @classmethod
    def of(
        cls,
        images: Images,
        view: int,
        noise: Float[np.ndarray, " views"],
        parts: tuple[Part, ...],
    ) -> "ViewAlignment":
        """Set up the alignment of one view with the points of all others."""
        rest = [v for v in range(len(images.names)) if v != view]
        paths = Trajectories.of(images.view(rest), noise[rest])
        moments = images.pixels.shape[1]
        frames = np.unique(np.linspace(0, moments - 1, min(moments, _MAX_FRAMES)).astype(int))
        sigma = float(noise[view])
        return cls(images.view([view]), view, paths, sigma, parts, frames.astype(float))

    @property
    def rows(self) -> np.ndarray:
        """The frame numbers as array indices."""
        return self.frames.astype(int)

    @property
    def seen(self) -> Bool[np.ndarray, "moments points"]:
        """Mask of this view's keypoints whose points the other views triangulate."""
        return self.images.seen[0, self.rows] & self.paths.exists[self.rows]

    @property
    def is_determined(self) -> bool:
        """Whether the other views agree with each other and enough keypoints are seen."""
        return bool(self.paths.noise <= NOISE and self.seen.sum() >= _MIN_KEYPOINTS)

    @property
    def may_improve(self) -> bool:
        """Whether a correction might improve the view: a cheap test without a search."""
        given = self._residuals(0.0, self.images.pose[0, 0])
        if (
            given.there.sum() < _MIN_KEYPOINTS
            or cauchy_mean(given.squared[given.there]) > _MAX_CLEAN_COST
        ):
            return self.is_determined
        normal, slope, _ = given.equations()
        gain = float(slope @ np.linalg.solve(normal + 1e-9 * np.eye(7), slope))
        return self.is_determined and gain > _MAX_CLEAN_GAIN

    def best_correction(self) -> ViewCorrection | None:
        """Find the correction with the least residuals; None if the data do not determine it."""
        if not self.is_determined:
            return None
        start = self.images.pose[0, 0]
        (late, pose), _ = minimise(self, self._best_clock_and_pose(start), _OPTIONS)
        found = self._residuals(late, pose)
        if found.there.sum() < _MIN_KEYPOINTS:
            return None
        normal, _, inflation = self._equations((late, pose), found)
        covariance, unknown = (
            np.zeros((7, 7)),
            np.ix_(self._unknown_indices, self._unknown_indices),
        )
        covariance[unknown] = np.linalg.inv(normal[unknown])
        turn = Rotation.from_matrix(pose[:3, :3] @ start[:3, :3].T).as_rotvec()
        values = np.concatenate(([late], turn, self._shift_of_centre(pose)))
        given = self._residuals(0.0, start)
        both = found.there & given.there
        if not both.any():
            return None
        away = found.predicted[both] - given.predicted[both]
        moves = float(np.sqrt(np.square(away).sum(-1).mean() / 2)) / self.sigma
        others = self.paths.disagreement[self.rows][self.seen]
        per_point = cauchy_mean(found.squared[found.there]) + cauchy_mean(others)
        return ViewCorrection(
            self.view, float(late), pose, values, covariance, found.spread,
            per_point * float(self.seen.sum()), inflation, moves,
        )  # fmt: skip

    @property
    def _unknown_indices(self) -> list[int]:
        return [k for part in self.parts for k in range(7)[_UNKNOWN[part]]]

    def _shift_of_centre(self, pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
        """Return the shift (m) of the camera's centre from the given one, along its axes."""
        return pose[:3, :3] @ (camera_centre(pose) - camera_centre(self.images.pose[0, 0]))

    def _equations(
        self, x: _ClockAndPose, found: "_Residuals"
    ) -> tuple[Float[np.ndarray, "7 7"], Float[np.ndarray, "7"], float]:
        """Return Hessian, descent direction, and residuals' variance relative to white noise."""
        normal, slope, inflation = found.equations()
        normal[4:, 4:] += np.eye(3) / SHIFT**2
        slope[4:] -= self._shift_of_centre(x[1]) / SHIFT**2
        return normal, slope, inflation

    def model(self, x: _ClockAndPose, rows: Int[Tensor, " rows"]) -> Quadratic:
        """Model the robust cost about a correction as quadratic; flat if too little is seen."""
        found, own = self._residuals(*x), self._unknown_indices
        normal, slope = np.eye(7), np.zeros(7)
        if found.there.sum() >= _MIN_KEYPOINTS:
            normal, slope, _ = self._equations(x, found)
        hessian = Banded.dense(torch.from_numpy(normal[np.ix_(own, own)]))
        return Quadratic(self.value(x, rows), -torch.from_numpy(slope[own])[None], [hessian])

    def moved(
        self, x: _ClockAndPose, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> _ClockAndPose:
        """Return the correction after a step that changes the clock by at most two frames."""
        del rows
        step = np.zeros(7)
        step[self._unknown_indices] = steps[0].numpy()
        return x[0] + float(np.clip(step[0], -2.0, 2.0)), _moved_pose(x[1], step[1:4], step[4:])

    def _best_clock_and_pose(
        self, pose: Float[np.ndarray, "4 4"]
    ) -> tuple[float, Float[np.ndarray, "4 4"]]:
        """Return the coarse clock offset (frames) and pose where the view fits the points best."""
        if "clock" not in self.parts:
            return 0.0, pose
        fps, moments = self.images.fps, self.images.pixels.shape[1]
        most = min(MAX_LATE_S * fps, (1 - _MIN_OVERLAP) * moments)
        count = int(most / max(COARSE_STEP_S * fps, 1.0))
        best = (np.inf, 0.0, pose)
        step = max(len(self.frames) // _COARSE_FRAMES, 1)
        some = replace(self, frames=self.frames[::step])
        lates = np.arange(-count, count + 1) * max(COARSE_STEP_S * fps, 1.0)
        for late in sorted(lates.tolist(), key=abs):
            turned = some._pose_turned_onto_points(late, pose) if "pose" in self.parts else pose
            found = some._residuals(late, turned)
            if found.there.sum() < _MIN_KEYPOINTS / step:
                continue
            away = float(np.median(found.squared[found.there]))
            if away < _MAX_RESIDUAL_RATIO * best[0]:
                best = (away, late, turned)
        return best[1], best[2]

    def _pose_turned_onto_points(
        self, late: float, pose: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "4 4"]:
        points, _, _, exists = self.paths.at(self.frames - late)
        local, front = in_camera(pose, points)
        rays = ray_directions(self.images)[0, self.rows]
        targets = local / np.maximum(np.linalg.norm(local, axis=-1, keepdims=True), 1e-9)
        there = self.seen & exists & front
        if not there.any():
            return pose
        turn = robust_rotations(targets[there][None], rays[there][None], there[there][None])[0]
        return _moved_pose(pose, Rotation.from_matrix(turn).as_rotvec(), np.zeros(3))

    def _residuals(self, late: float, pose: Float[np.ndarray, "4 4"]) -> "_Residuals":
        points, velocity, covariance, exists = self.paths.at(self.frames - late)
        local, front = in_camera(pose, points)
        predicted = projected(self.images, local[None], front[None])[0]
        there = self.images.seen[0, self.rows] & exists & front
        away = self.images.pixels[0, self.rows] - predicted
        by_place = self.images.matrix[0, :2, :2] @ derivatives_of_projection(local, front)
        by_point = by_place @ pose[:3, :3]
        noise = by_point @ covariance @ np.swapaxes(by_point, -1, -2)
        noise = noise + self.sigma**2 * np.eye(2)
        whiten = np.linalg.inv(np.linalg.cholesky(noise))
        jacobian = np.concatenate(
            (
                -(by_point @ velocity[..., None]),
                by_place @ derivatives_by_rotation(local),
                -by_place,
            ),
            -1,
        )
        by_velocity = whiten @ by_point
        blur = self.paths.velocity_noise * (by_velocity @ covariance * by_velocity).sum((-2, -1))
        white = np.where(there[..., None], (whiten @ away[..., None])[..., 0], 0.0)
        past = self.frames - late - np.rint(self.frames - late)
        return _Residuals(white, whiten @ jacobian, blur, past, predicted, there)


@dataclass(frozen=True)
class _Residuals:
    """Whitened residuals of a view, and their derivatives by the seven unknowns."""

    white: Float[np.ndarray, "moments points 2"]
    jacobian: Float[np.ndarray, "moments points 2 7"]
    blur: Float[np.ndarray, "moments points"]
    """Expected part of the velocities' noise in the squared derivative by the clock."""
    past: Float[np.ndarray, " moments"]
    """Number of frames from the middle of the parabola that gave each frame's positions."""
    predicted: Float[np.ndarray, "moments points 2"]
    """Projections of the points (pixels)."""
    there: Bool[np.ndarray, "moments points"]

    @property
    def squared(self) -> Float[np.ndarray, "moments points"]:
        return np.square(self.white).sum(-1)

    @property
    def spread(self) -> float:
        """Standard deviation of the residuals, estimated from their median."""
        return float(np.sqrt(np.median(self.squared[self.there]) / _MEDIAN_SQUARED_LENGTH))

    def equations(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Return normal equations of a step, and the residuals' variance over that of white noise.

        If nobody moves, so that the residuals do not depend on the clock, it is left unchanged.

        Neighbouring residuals are correlated by the detector or by smoothing; the variance is
        increased by the resulting loss of independent samples.
        """
        scale = max(self.spread, 1.0) ** 2
        weight = self.there / (1 + self.squared / (_OUTLIER_SQUARED_STDS * scale))
        j, r = self.jacobian[self.there], self.white[self.there]
        counted = weight[self.there]
        both = self.there[1:] & self.there[:-1]
        soft = self.white * np.sqrt(weight)[..., None]
        along = float((soft[1:] * soft[:-1])[both].sum() / max((soft[1:][both] ** 2).sum(), 1e-9))
        along = float(np.clip(along, 0.0, 0.95))
        inflation = scale * (1 + along) / (1 - along)
        weighed = (j * counted[:, None, None]).reshape(-1, 7).T
        normal, slope = weighed @ j.reshape(-1, 7), weighed @ r.ravel()
        # errors of fitted velocities look like a clock offset: subtract what they add on average
        blur = counted * self.blur[self.there]
        past = np.broadcast_to(self.past[:, None], self.there.shape)[self.there]
        slope[0] -= float((blur * past).sum())
        raw, normal[0, 0] = normal[0, 0], normal[0, 0] - blur.sum()
        if normal[0, 0] <= _MIN_MOTION_SHARE * raw:
            normal[0], normal[:, 0], slope[0] = 0.0, 0.0, 0.0
            normal[0, 0] = 1e-9
        return normal / inflation, slope / inflation, inflation


def cauchy_mean(squared: Float[np.ndarray, " samples"]) -> float:
    """Return Cauchy's robust mean of squared residuals, in which large ones count less."""
    return _OUTLIER_SQUARED_STDS * float(np.log1p(squared / _OUTLIER_SQUARED_STDS).mean())


def _moved_pose(
    pose: Float[np.ndarray, "4 4"], turn: Float[np.ndarray, "3"], shift: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Return the camera pose after a rotation about its centre and a shift along its axes."""
    if not turn.any() and not shift.any():
        return pose
    out = pose.copy()
    out[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
    out[:3, 3] = -out[:3, :3] @ (camera_centre(pose) + out[:3, :3].T @ shift)
    return out
