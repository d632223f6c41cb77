"""Refines camera poses, background points and a focal length together (bundle adjustment).

After Triggs et al. 2000. A picture of rotation R and translation t sees the point X = (x, y, z, w)
at f π(R (x, y, z) + w t), π(a, b, c) = (a, b) / c. Points are homogeneous and of length one, so
that those far away do no harm. Damped Gauss-Newton steps, points eliminated, lower the sum of
Geman-McClure functions r² / (1 + r²), r being reprojection errors over their standard deviation.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from recon.core import rotations as so3

NOISE = 0.001
"""Standard deviation of an observed point, as a tangent (about radians)."""
_MISFIT = 4.0
"""Reprojection error, in multiples of the noise, above which an observation is a misfit."""
_CLOSEST = 1e-6
"""Least depth of a homogeneous point of length one that lies in front of a camera."""
_RIDGE = 1e-9
"""Added to the diagonal of normal matrices, which observations may leave singular."""
_MOST_DAMPING, _LEAST_DAMPING = 1e6, 1e-7
_SMALL_GAIN = 1e-4
"""Relative decrease of the objective in a step, below which a refinement ends."""
_MOST_ZOOM = 0.1
"""Largest change of the logarithm of the focal length in a step."""


@dataclass
class SeenBackground:
    """Camera poses of pictures, background points in space, and observations of these points."""

    picture: Int[np.ndarray, " seen"]
    point: Int[np.ndarray, " seen"]
    places: Float[np.ndarray, "seen 2"]
    """Observed x/z and y/z in the camera's frame, by the focal length that was given."""
    R: Float[np.ndarray, "pictures 3 3"]
    """Rotations from the world to the cameras; `t` are the translations."""
    t: Float[np.ndarray, "pictures 3"]
    X: Float[np.ndarray, "points 4"]
    placed: Bool[np.ndarray, " pictures"]
    """Whether the pose of each picture is known."""
    known: Bool[np.ndarray, " points"]
    focal: float = 1.0
    """Focal length as a multiple of the one that was given."""
    normal: Float[np.ndarray, "n n"] = field(default_factory=lambda: np.zeros((0, 0)))
    """Normal matrix of the last refinement of points, which are eliminated: rotation and
    translation of every moved picture, and the logarithm of the focal length if it was free."""

    def are_usable(self) -> Bool[np.ndarray, " seen"]:
        """Return which observations are of known points in pictures with known poses."""
        return self.placed[self.picture] & self.known[self.point]

    def camera_positions(self) -> Float[np.ndarray, "pictures 3"]:
        """Return the cameras' positions in the world."""
        return -np.einsum("kji,kj->ki", self.R, self.t)

    def points_in_cameras(self, rows: Int[np.ndarray, " rows"]) -> Float[np.ndarray, "rows 3"]:
        """Return observed points in the frames of their cameras, times their homogeneous w."""
        k, X = self.picture[rows], self.X[self.point[rows]]
        return np.einsum("nij,nj->ni", self.R[k], X[:, :3]) + self.t[k] * X[:, 3:]

    def errors(self, rows: Int[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Return reprojection errors in units of the focal length; infinite behind a camera."""
        in_camera = self.points_in_cameras(rows)
        in_front = in_camera[:, 2] > _CLOSEST
        seen = in_camera[:, :2] / np.where(in_front, in_camera[:, 2], 1.0)[:, None]
        return np.where(
            in_front, np.linalg.norm(self.focal * seen - self.places[rows], axis=1), np.inf
        )

    def triangulate(self) -> None:
        """Triangulate points not yet known that two or more pictures of known pose see."""
        rows = np.flatnonzero(self.placed[self.picture] & ~self.known[self.point])
        P = np.concatenate((self.R, self.t[:, :, None]), 2)[self.picture[rows]]
        A = (self.places[rows] / self.focal)[:, :, None] * P[:, 2:] - P[:, :2]
        square = np.zeros((len(self.X), 4, 4))
        np.add.at(square, self.point[rows], A.swapaxes(1, 2) @ A)
        chosen = np.bincount(self.point[rows], minlength=len(self.X)) >= 2
        self.X[chosen] = np.linalg.eigh(square[chosen])[1][:, :, 0]
        # choose the sign that puts a homogeneous point in front of the first camera that sees it
        first = rows[np.unique(self.point[rows], return_index=True)[1]]
        first = first[chosen[self.point[first]]]
        self.X[self.point[first]] *= np.sign(self.points_in_cameras(first)[:, 2:])
        self.known |= chosen
        self.drop_misfits()

    def drop_misfits(self) -> None:
        """Mark points as unknown that fit in at most one, or less than half, of their pictures."""
        rows = np.flatnonzero(self.are_usable())
        fits = rows[self.errors(rows) < _MISFIT * NOISE]
        count_of_all, count_of_fits = (
            np.bincount(self.point[own], minlength=len(self.X)) for own in (rows, fits)
        )
        self.known &= (count_of_fits >= 2) & (2 * count_of_fits >= count_of_all)

    def refine(
        self,
        moved: Bool[np.ndarray, " pictures"],
        *,
        points: bool = True,
        focal_std: float | None = None,
        steady: float | None = None,
        wider: float = 1.0,
        steps: int = 10,
    ) -> None:
        """Minimise robust reprojection errors over poses, and over points and focal length.

        Args:
            moved: which pictures' poses change.
            points: whether points move.
            focal_std: standard deviation of the logarithm of the focal length; None keeps it.
            steady: standard deviation of second differences of cameras' positions; None is
                without this term.
            wider: multiple of the noise beyond which observations count little.
            steps: largest number of steps.
        """
        problem = _Adjustment(
            self, np.flatnonzero(self.are_usable() & (moved[self.picture] | points)), moved,
            points, focal_std, steady, wider * NOISE,
        )  # fmt: skip
        value, damping = problem.cost(), 1e-4
        for _ in range(steps):
            kept, take_step = (self.R, self.t, self.X, self.focal), problem.linearised()
            take_step(damping)
            while not (now := problem.cost()) < value:
                self.R, self.t, self.X, self.focal = kept
                damping *= 10
                if damping > _MOST_DAMPING:
                    return
                take_step(damping)
            gain, value = value - now, now
            damping = max(damping / 10, _LEAST_DAMPING)
            if gain < _SMALL_GAIN * value:
                return


@dataclass(frozen=True)
class _Adjustment:
    """The objective of `SeenBackground.refine`: robust reprojection errors and priors."""

    scene: SeenBackground
    rows: Int[np.ndarray, " rows"]
    moved: Bool[np.ndarray, " pictures"]
    points_move: bool
    focal_std: float | None
    steadiness_std: float | None
    scale: float

    def cost(self) -> float:
        """Return the value of the objective for the present scene."""
        square = (self.scene.errors(self.rows) / self.scale) ** 2
        total = float((1 - 1 / (1 + square)).sum())
        if self.focal_std is not None:
            total += (np.log(self.scene.focal) / self.focal_std) ** 2
        if self.steadiness_std is not None:
            total += float((self.second_differences() ** 2).sum())
        return total

    def second_differences(self) -> Float[np.ndarray, "inner 3"]:
        """Return second differences of cameras' positions, divided by their standard deviation."""
        return (
            np.diff(self.scene.camera_positions()[self.moved], n=2, axis=0) / self.steadiness_std
        )

    def linearised(self) -> Callable[[float], None]:
        """Linearise the objective here; return a function that takes a step of given damping."""
        off, D, columns = self._weighted_errors()
        H, g = self._with_priors(columns.T @ columns, columns.T @ off.ravel())
        if self.points_move:
            return self._step_without_points(off, D, columns, H, g)
        return lambda damping: self._apply_step(
            -spsolve((H + sparse.diags_array(damping * H.diagonal() + _RIDGE)).tocsc(), g), None
        )

    def _weighted_errors(
        self,
    ) -> tuple[Float[np.ndarray, "rows 2"], Float[np.ndarray, "rows 2 3"], Any]:
        """Return reprojection errors, and their derivatives by what is observed and by the camera.

        The first derivatives are by points in the frames of their cameras; the others, a sparse
        matrix, by all moved poses (rotations about the cameras' centres, then translations) and,
        if it is free, by the logarithm of the focal length. All are multiplied by the square root
        of the weight (1 + r²)⁻² of iteratively reweighted least squares.
        """
        scene, k = self.scene, self.scene.picture[self.rows]
        there = scene.points_in_cameras(self.rows)
        front = there[:, 2] > _CLOSEST
        z = np.where(front, there[:, 2], 1.0)[:, None]
        seen = there[:, :2] / z
        off = scene.focal * seen - scene.places[self.rows]
        root = np.where(front, 1 / (1 + (off**2).sum(1) / self.scale**2), 0.0) / self.scale
        off, root = off * root[:, None], root[:, None, None]
        D = np.concatenate((np.tile(np.eye(2), (len(k), 1, 1)), -seen[:, :, None]), 2)
        D *= scene.focal * root / z[:, None]
        cross = so3.hat(torch.from_numpy(there)).numpy()
        w = scene.X[scene.point[self.rows], 3][:, None, None]
        poses = np.concatenate((-D @ cross, D * w), 2) * self.moved[k][:, None, None]
        number = np.maximum(np.cumsum(self.moved)[k] - 1, 0)
        columns = _sparse_blocks(poses, number, int(self.moved.sum()))
        if self.focal_std is not None:
            zoom = sparse.csr_array((scene.focal * seen * root[:, 0]).reshape(-1, 1))
            columns = sparse.hstack((columns, zoom), format="csr")
        return off, D, columns

    def _with_priors(self, H: Any, g: np.ndarray) -> tuple[Any, np.ndarray]:
        """Add the terms without points to normal matrix and gradient: steadiness, focal length."""
        if self.steadiness_std is not None:
            one: Any = sparse.eye_array(int(self.moved.sum()), format="csr")
            bend = sparse.kron(one[:-2] - 2 * one[1:-1] + one[2:], sparse.eye_array(3))
            shift = [np.hstack((np.zeros((3, 3)), -own.T)) for own in self.scene.R[self.moved]]
            Jd = bend @ sparse.block_diag(shift) / self.steadiness_std
            H, g = H + Jd.T @ Jd, g + Jd.T @ self.second_differences().ravel()
        if self.focal_std is not None:
            last = np.zeros(len(g))
            last[-1] = self.focal_std**-2
            H, g = H + sparse.diags_array(last), g + last * np.log(self.scene.focal)
        return H, g

    def _step_without_points(
        self,
        off: Float[np.ndarray, "rows 2"],
        D: Float[np.ndarray, "rows 2 3"],
        columns: Any,
        H: Any,
        g: Float[np.ndarray, " n"],
    ) -> Callable[[float], None]:
        """Return a function that takes a damped step, for which points are eliminated (Schur).

        Points move perpendicular to themselves, as they are homogeneous and of length one.
        """
        scene, k = self.scene, self.scene.picture[self.rows]
        used, which = np.unique(scene.point[self.rows], return_inverse=True)
        basis = _perpendicular_bases(scene.X[used])
        Jp = D @ np.concatenate((scene.R[k], scene.t[k][:, :, None]), 2) @ basis[which]
        Hpp, gp = np.zeros((len(used), 3, 3)), np.zeros((len(used), 3))
        np.add.at(Hpp, which, Jp.swapaxes(1, 2) @ Jp)
        np.add.at(gp, which, np.einsum("nij,ni->nj", Jp, off))
        W = columns.T @ _sparse_blocks(Jp, which, len(used))

        def schur_complement(damping: float) -> tuple[np.ndarray, Any, Any]:
            added = (damping * np.einsum("pii->pi", Hpp) + _RIDGE)[:, :, None] * np.eye(3)
            inverse, blocks = np.linalg.inv(Hpp + added), np.arange(len(used) + 1)
            WV = W @ sparse.bsr_array((inverse, blocks[:-1], blocks))
            return inverse, WV, (H - WV @ W.T).toarray()

        scene.normal = schur_complement(0.0)[2]

        def take_step(damping: float) -> None:
            inverse, WV, S = schur_complement(damping)
            damped = S + np.diag(damping * S.diagonal() + _RIDGE)
            step = -np.linalg.solve(damped, g - WV @ gp.ravel())
            own = -np.einsum("pij,pj->pi", inverse, gp + (W.T @ step).reshape(-1, 3))
            self._apply_step(step, (used, np.einsum("pij,pj->pi", basis, own)))

        return take_step

    def _apply_step(
        self, step: Float[np.ndarray, " n"], points: tuple[np.ndarray, np.ndarray] | None
    ) -> None:
        scene = self.scene
        if self.focal_std is not None:
            scene.focal *= float(np.exp(np.clip(step[-1], -_MOST_ZOOM, _MOST_ZOOM)))
        steps = step[: 6 * int(self.moved.sum())].reshape(-1, 6)
        turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        scene.R, scene.t = scene.R.copy(), scene.t.copy()
        scene.R[self.moved] = turns @ scene.R[self.moved]
        scene.t[self.moved] = np.einsum("kij,kj->ki", turns, scene.t[self.moved]) + steps[:, 3:]
        if points is not None:
            used, change = points
            X = scene.X[used] + change
            scene.X = scene.X.copy()
            scene.X[used] = X / np.linalg.norm(X, axis=1, keepdims=True)


def _sparse_blocks(values: Float[np.ndarray, "rows 2 n"], number: np.ndarray, count: int) -> Any:
    """Return a sparse matrix of 2 x n blocks: block k is in block column `number[k]`, row k."""
    rows, _, n = values.shape
    columns = np.broadcast_to(n * number[:, None, None] + np.arange(n), values.shape)
    ends = np.arange(0, values.size + 1, n)
    return sparse.csr_array((values.ravel(), columns.ravel(), ends), (2 * rows, n * count))


def _perpendicular_bases(X: Float[np.ndarray, "points 4"]) -> Float[np.ndarray, "points 4 3"]:
    """Return orthonormal bases of the spaces perpendicular to unit vectors (Householder)."""
    v = X + np.where(X[:, :1] >= 0, 1.0, -1.0) * np.eye(4)[0]
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return (np.eye(4) - 2 * v[:, :, None] * v[:, None, :])[:, :, 1:]
