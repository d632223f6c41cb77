"""Finds and corrects a wrong clock or pose of one camera of a rig.

With three or more views, leaving one out shows which is wrong: the others agree, and the wrong one
agrees with them after a correction of its clock and pose. Two views show that something is wrong,
but not in which of them.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation
from torch import Tensor

from recon.diagnosis.explanations import shifted_in_time
from recon.diagnosis.findings import Code, Finding, Findings
from recon.diagnosis.images import Images
from recon.diagnosis.rays import Rays
from recon.diagnosis.registration import (
    COARSE_STEP_S,
    MAX_LATE_S,
    NOISE,
    PARTS,
    Part,
    ViewAlignment,
    ViewCorrection,
)
from recon.solver.banded import Banded
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise

_OPTIONS = GaussNewton(8, tolerance=1e-12, scale=1.0, damping=1e-6)
"""Iterations end when the sum of squared distances would fall by less than 1e-12 m²."""
_LATE_STEP, _TURN_STEP = 0.5, 1e-4
"""Half steps, in frames and radians, of the finite differences that give derivatives."""
_UNKNOWN: dict[Part, tuple[int, ...]] = {"clock": (0,), "pose": (1, 2, 3)}


@dataclass(frozen=True)
class TwoViewCorrection:
    """The correction of the clock or rotation with which two views agree best."""

    images: Images
    """Keypoints and cameras of the two views, the second one corrected."""
    late: float
    """Number of frames by which the second view is late."""
    degrees: float
    """Angle (degrees) by which one of the cameras is rotated."""
    remains: float
    """Median distance (m) of rays from triangulated points after the correction."""


def best_agreement(images: Images, parts: tuple[Part, ...]) -> TwoViewCorrection:
    """Find the clock and rotation of the second view with which rays of both meet most closely."""
    unknown = [k for part in parts for k in _UNKNOWN[part]]
    turns = _RayDistances(images, [k for k in unknown if k > 0], 0.0)
    best: tuple[float, np.ndarray] = (np.inf, np.zeros(4))
    for late in _offsets_to_try(images) if "clock" in parts else (0.0,):
        values = np.array([late, 0.0, 0.0, 0.0])
        if turns.unknown:
            values, _ = minimise(turns, values, replace(_OPTIONS, max_iterations=2))
        away = _median_absolute(_distances_of_rays(images, late, values[1:])[0])
        if away < best[0]:
            best = (away, values)
    most = max(abs(late) for late in _offsets_to_try(images))
    values, _ = minimise(_RayDistances(images, unknown, most), best[1], _OPTIONS)
    pose = images.pose.copy()
    pose[1, :, :3] = Rotation.from_rotvec(values[1:]).as_matrix() @ pose[1, :, :3]
    corrected = shifted_in_time(replace(images, pose=pose), 1, float(values[0]))
    angle = float(np.degrees(np.linalg.norm(values[1:])))
    return TwoViewCorrection(corrected, float(values[0]), angle, ray_distance(corrected))


def ray_distance(images: Images) -> float:
    """Return the median distance (m) of rays from the points triangulated from them."""
    rays = Rays.of(images)
    points, exists = rays.triangulated()
    there = exists & (rays.weight > 0)
    return float(np.median(rays.distances_from(points)[there])) if there.any() else 0.0


def _offsets_to_try(images: Images) -> Float[np.ndarray, " offsets"]:
    step = max(COARSE_STEP_S * images.fps, 1.0)
    count = int(min(MAX_LATE_S * images.fps, images.pixels.shape[1] / 2) / step)
    return np.arange(-count, count + 1) * step


def _distances_of_rays(
    images: Images, late: float, *turns: Float[np.ndarray, "3"]
) -> list[Float[np.ndarray, "moments points"]]:
    """Return signed distances (m) between the two views' rays of every keypoint; 0 if missing.

    Args:
        images: keypoints and cameras of two views.
        late: number of frames by which the second view is shifted in time.
        turns: rotation vectors of its camera about its centre, one for each returned array.
    """
    rays, R = Rays.of(shifted_in_time(images, 1, late)), images.pose[1, :, :3, :3]
    there, between = (rays.weight > 0).all(0), rays.origin[1] - rays.origin[0]
    found: list[np.ndarray] = []
    for turn in turns:
        carry = np.swapaxes(R, -1, -2) @ Rotation.from_rotvec(turn).as_matrix() @ R
        across = np.cross(rays.direction[0], rays.direction[1] @ carry)
        size = np.linalg.norm(across, axis=-1)
        both = there & (size > 0.03)
        found.append(np.where(both, (between * across).sum(-1) / np.where(both, size, 1.0), 0.0))
    return found


def _median_absolute(away: Float[np.ndarray, "moments points"]) -> float:
    """Return the median absolute value of the non-zero distances."""
    there = away != 0
    return float(np.median(np.abs(away[there]))) if there.any() else np.inf


@dataclass(frozen=True)
class _RayDistances(Problem[Float[np.ndarray, "4"]]):
    """Distances between rays of two views as a function of the second one's clock and pose."""

    images: Images
    unknown: list[int]
    """Indices of the unknowns among clock offset and rotation vector; the others stay fixed."""
    latest: float
    """Largest clock offset (frames), if it is unknown."""

    def model(self, x: Float[np.ndarray, "4"], rows: Int[Tensor, " rows"]) -> Quadratic:
        """Model the distances' robust cost as quadratic; flat if too little is seen."""
        unknown, late, turn = self.unknown, float(x[0]), x[1:]
        ends = [turn + side * step for step in _TURN_STEP * np.eye(3) for side in (1, -1)]
        away, *ends = _distances_of_rays(self.images, late, turn, *(ends if 1 in unknown else ()))
        columns = [(a - b) / (2 * _TURN_STEP) for a, b in zip(ends[::2], ends[1::2], strict=True)]
        if 0 in unknown:
            later = _distances_of_rays(self.images, late + _LATE_STEP, turn)[0]
            earlier = _distances_of_rays(self.images, late - _LATE_STEP, turn)[0]
            columns.insert(0, (later - earlier) / (2 * _LATE_STEP))
        jacobian = np.stack(columns, -1)
        there = (away != 0) & (jacobian != 0).any(-1)
        j, r = jacobian[there], away[there]
        normal, slope = np.eye(len(unknown)), np.zeros(len(unknown))
        if len(r) > len(unknown):
            weight = 1 / (1 + np.square(r / max(3 * float(np.median(np.abs(r))), 1e-9)))
            normal = (j * weight[:, None]).T @ j + 1e-12 * np.eye(len(unknown))
            slope = j.T @ (weight * r)
        hessian = Banded.dense(torch.from_numpy(normal))
        return Quadratic(self.value(x, rows), torch.from_numpy(slope)[None], [hessian])

    def moved(
        self, x: Float[np.ndarray, "4"], rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> Float[np.ndarray, "4"]:
        """Return clock offset and rotation vector after a step."""
        del rows
        out = x.copy()
        out[self.unknown] += steps[0].numpy()
        if 0 in self.unknown:
            out[0] = np.clip(out[0], -self.latest, self.latest)
        return out


_MIN_NOISE_PX = 0.5
"""Least standard deviation (pixels) that is assumed of keypoints."""
_MIN_SQUARED_STDS = 60.0
"""Squared size, in standard deviations, from which on a part of a correction is certain."""
_MIN_OTHER_SQUARED_STDS = 30.0
"""Squared size, in standard deviations, of a part that is corrected with a certain one."""
_MIN_MOVED_STDS = 0.4
"""Distance, in standard deviations of the keypoints, by which a correction must move them."""
_MIN_COST_GAP = 60.0
"""Difference of robust squared residuals from which on one view is clearly the better one to
correct."""
_MIN_CLOCK_S = 0.004
"""Clock error (s) below which nothing is corrected."""
_MIN_TURN_DEG = 0.08
"""Rotation (degrees) below which, with a shift below `_MIN_SHIFT_M`, a pose is left unchanged."""
_MIN_SHIFT_M = 0.01
"""Shift (m) below which, with a small rotation, a pose is left unchanged."""


@dataclass(frozen=True)
class CorrectedRig:
    """The views after all certain corrections, and the uncertain correction, if any."""

    images: Images
    """All views after the corrections."""
    applied: tuple[ViewCorrection, ...] = ()
    undecided: tuple[ViewCorrection, ...] = ()
    """Corrections of different views after which the rays fit equally well."""


def with_certain_corrections(images: Images) -> CorrectedRig:
    """Correct clocks and poses of cameras where the correction is certain.

    Views are corrected one after the other, as long as two views remain without a correction.
    """
    applied: tuple[ViewCorrection, ...] = ()
    for _ in range(len(images.names) - 2):
        found = candidate_corrections(images)
        if not found or not is_certain(found[0], images.fps):
            break
        best = found[0]
        alike = [one for one in found if one.cost - best.cost < _MIN_COST_GAP * best.inflation]
        if len(alike) > 1:
            return CorrectedRig(images, applied, tuple(alike))
        images, applied = best.applied_to(images), (*applied, best)
    return CorrectedRig(images, applied)


def repaired_rig(images: Images) -> tuple[Images, Findings]:
    """Return the views after `with_certain_corrections`, and these corrections as findings."""
    found = with_certain_corrections(images)
    repairs = tuple(_finding_of_correction(images, one) for one in found.applied)
    if not found.undecided:
        return found.images, Findings(repairs)
    every = [
        f"{images.names[one.view]}: {_error_in_words(one, images.fps)}" for one in found.undecided
    ]
    said = Finding(
        "view at odds",
        "the views contradict each other, and they do not tell which of them is wrong: "
        f"{'; or '.join(every)}. Nothing was changed. Check the calibration and the clocks, or "
        "add a view",
        value=found.undecided[0].degrees,
    )
    return found.images, Findings(repairs, (said,))


def candidate_corrections(images: Images) -> list[ViewCorrection]:
    """Return candidate corrections of single fixed views, sorted by the remaining error.

    The list is empty where every view agrees with the others.
    """
    noise = np.maximum(images.noise, _MIN_NOISE_PX)
    fixed = [v for v, still in enumerate(images.fixed) if still]
    given = (
        [ViewAlignment.of(images, v, noise, PARTS) for v in fixed]
        if np.isfinite(noise).all()
        else []
    )
    if not any(one.may_improve for one in given):
        return []
    every = [_simplest_correction(images, one) for one in given]
    return sorted((one for one in every if one is not None), key=lambda one: one.cost)


def is_certain(found: ViewCorrection, fps: float) -> bool:
    """Whether a correction is significant and leaves only noise as residuals."""
    if found.noise > NOISE or found.moves < _MIN_MOVED_STDS:
        return False
    return any(_is_needed(found, part, fps, _MIN_SQUARED_STDS) for part in PARTS)


def _simplest_correction(images: Images, given: ViewAlignment) -> ViewCorrection | None:
    """Find the correction with the fewest parts (clock, pose) that suffices for a view."""
    both = given.best_correction()
    if both is None:
        return None
    parts: list[Part] = [
        part for part in PARTS if _is_needed(both, part, images.fps, _MIN_OTHER_SQUARED_STDS)
    ]
    return both if len(parts) != 1 else replace(given, parts=(parts[0],)).best_correction()


def _is_needed(found: ViewCorrection, part: Part, fps: float, min_squared_stds: float) -> bool:
    is_large = found.degrees >= _MIN_TURN_DEG or found.metres >= _MIN_SHIFT_M
    if part == "clock":
        is_large = abs(found.late) / fps >= _MIN_CLOCK_S
    return is_large and found.squared_deviations(part) >= min_squared_stds


def _finding_of_correction(images: Images, found: ViewCorrection) -> Finding:
    code: Code = "views out of step" if found.late else "view at odds"
    advice = ["Number the frames of all cameras from the same moment"] if found.late else []
    if found.values[1:].any() or not found.late:
        advice.append("calibrate anew")
    text = ", and ".join(advice)
    return Finding(
        code,
        f"{images.names[found.view]} contradicts the other views: "
        f"{_error_in_words(found, images.fps)}. That was corrected. {text[0].upper()}{text[1:]}",
        value=found.late / images.fps if found.late else found.degrees,
        sensors=(images.names[found.view],),
    )


def _error_in_words(found: ViewCorrection, fps: float) -> str:
    """Describe a view's error in words, with standard deviations."""
    std = np.sqrt(np.diag(found.covariance))
    out: list[str] = []
    if found.late:
        late = found.late / fps
        out.append(
            f"its clock is {1000 * abs(late):.0f} ms {'late' if late > 0 else 'early'} "
            f"(standard deviation {1000 * std[0] / fps:.1f} ms)"
        )
    if found.values[1:].any():
        out.append(
            f"its camera is turned by {found.degrees:.2f} degrees "
            f"({np.degrees(std[1:4].max()):.2f}) and shifted by {100 * found.metres:.1f} cm "
            f"({100 * std[4:].max():.1f}) against the calibration"
        )
    return " and ".join(out)
