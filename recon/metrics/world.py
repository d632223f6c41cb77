"""Errors of motions in the world as papers on video define them: W-MPJPE, WA-MPJPE, RTE.

Definitions are those of the evaluation released with WHAM (Shin et al., CVPR 2024, section 4.1 and
appendix B), which follows SLAHMR (Ye et al., CVPR 2023, section 4): segments of 100 frames,
alignments with scale for joints and without it for the path. All numbers are in SI units; papers
print millimetres, percent and 10 m/s³.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core import rotations as so3
from recon.core.skeleton import FEET
from recon.metrics.errors import mean, point_errors, similarity_aligned

SEGMENT = 100
"""Frames of a segment that is aligned and averaged by itself; a last, shorter one counts too."""
FIRST = 2
"""Frames at the beginning of a segment by which W-MPJPE aligns it."""
STANDING_STEP = 0.01
"""Metres that a true foot moves from one frame to the next, below which it stands, at 30 Hz."""


def world_errors(
    predicted: Float[Tensor, "time 22 3"], truth: Float[Tensor, "time 22 3"], fps: float
) -> dict[str, float | None]:
    """All world errors of one clip; None where the clip is too short."""
    return {
        "w_mpjpe": w_mpjpe(predicted, truth),
        "wa_mpjpe": wa_mpjpe(predicted, truth),
        "rte": root_translation_error(predicted[:, 0], truth[:, 0]),
        "jitter": jitter(predicted, fps),
        "jitter_truth": jitter(truth, fps),
        "foot_sliding": foot_sliding(predicted, truth, fps),
    }


def wa_mpjpe(
    predicted: Float[Tensor, "time joints 3"], truth: Float[Tensor, "time joints 3"]
) -> float | None:
    """Mean joint error after a similarity fitted to each segment of 100 frames, metres."""
    return _mean_error(predicted, truth, SEGMENT)


def w_mpjpe(
    predicted: Float[Tensor, "time joints 3"], truth: Float[Tensor, "time joints 3"]
) -> float | None:
    """Mean joint error after a similarity fitted to the first two frames of each segment, metres.

    This is WHAM's and SLAHMR's definition. Other papers align the first frame alone, without
    scale, which can give three times the error for the same motion.
    """
    return _mean_error(predicted, truth, FIRST)


def root_translation_error(
    predicted: Float[Tensor, "time 3"], truth: Float[Tensor, "time 3"]
) -> float | None:
    """Mean error of the path after a rigid alignment, as a share of the true path's length.

    Papers print it in percent. None where the true root does not move.
    """
    length = truth.diff(dim=0).norm(dim=-1).sum()
    if not length > 0:
        return None
    x, y = predicted - predicted.mean(0), truth - truth.mean(0)
    turn = so3.nearest_rotation(y.mT @ x)
    return float(point_errors(x @ turn.mT, y).mean() / length)


def jitter(joints: Float[Tensor, "time joints 3"], fps: float) -> float | None:
    """Mean norm of the third differences of the joints, m/s³ (WHAM prints a tenth of this)."""
    return mean(joints.diff(n=3, dim=0).norm(dim=-1) * fps**3)


def foot_sliding(
    predicted: Float[Tensor, "time 22 3"], truth: Float[Tensor, "time 22 3"], fps: float
) -> float | None:
    """Return the mean step per 1/30 s of ankles and toes whose true step is below 1 cm, metres.

    WHAM takes four vertices of SMPL's feet. Here the joints of the feet are taken, so that
    bodies of other meshes can be compared.
    """
    feet = list(FEET)
    ours, theirs = (j[:, feet].diff(dim=0).norm(dim=-1) * fps / 30 for j in (predicted, truth))
    return mean(ours, theirs < STANDING_STEP)


def _mean_error(predicted: Tensor, truth: Tensor, fitted_frames: int) -> float | None:
    """Mean joint error after a similarity fitted to the first frames of each segment."""
    errors: list[Tensor] = []
    for here, there in zip(predicted.split(SEGMENT), truth.split(SEGMENT), strict=True):
        points, goal = here.flatten(0, 1), there.flatten(0, 1)
        aligned = similarity_aligned(points, goal, fitted=fitted_frames * here.shape[1])
        errors.append(point_errors(aligned, goal))
    return mean(torch.cat(errors))
