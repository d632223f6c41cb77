"""Points of the skin from an earlier estimate of a motion, with errors correlated over time.

A network that looks at video is not noisy as a sensor is: what it gets wrong in one frame it gets
wrong in the next, by joint, and the whole path drifts. Counted as independent, a second of such
frames would outweigh what is known of people. So residuals are weighed by the inverse of their
covariance in time: fast changes are believed, slow deviations are cheap.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from observations.markers3d import Markers3D
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.residuals import Noise
from recon.method.protocols import REFERENCE_FPS, Estimate

_SCALE = 0.014
"""Metres: the noise of a usual sensor, in terms of whose energy that of an estimate is given."""
_UNSEEN = 10.0
"""Metres: standard deviation of what was not seen, so that it counts nothing."""


@dataclass(frozen=True)
class ErrorCovariance:
    """Covariance over time of the error of one coordinate of an estimated point.

    White jitter plus a slowly changing part, metres per axis.
    """

    jitter: float
    """Standard deviation at 30 Hz of the part of the error that is independent in every frame."""
    slow: float
    """Standard deviation of the part of the error that changes slowly."""
    seconds: float
    """Time after which the correlation of the slow part has fallen to about one half."""

    def precision_matrix(
        self,
        scale: Float[Tensor, "*batch moments"],
        segment: Float[Tensor, "*batch moments"],
        fps: float,
    ) -> Float[Tensor, "*batch moments moments"]:
        """Return the inverse covariance matrix (frames, frames) of an error, 1 / metres².

        Args:
            scale: multiplier of the jitter at every moment; infinite where nothing was seen.
            segment: number of the stretch of time that a moment is in; what lasts in one has
                nothing to do with what lasts in another.
            fps: moments per second.
        """
        times = torch.arange(scale.shape[-1], dtype=torch.float64, device=scale.device) / fps
        away = 3**0.5 * (times[:, None] - times).abs() / self.seconds
        slow = self.slow**2 * (1 + away) * (-away).exp()  # Matérn covariance of smoothness 3/2
        slow = slow * (segment[..., :, None] == segment[..., None, :])
        # jitter grows with the frame rate, so that a second of data says equally much at any rate
        jitter = self.jitter * (fps / REFERENCE_FPS) ** 0.5 * scale.double()
        variance = jitter.clamp(max=_UNSEEN).square()
        return torch.linalg.inv(slow + torch.diag_embed(variance)).to(scale.dtype)


@dataclass(frozen=True, kw_only=True)
class EstimatedPoints(Markers3D):
    """Points of the skin of an earlier estimate of the motion, used as measurements.

    The energy is ½ s² r' C⁻¹ r for the residuals r of every coordinate in time, with the
    covariance C of `path` for the mean of all points and that of `own` for every point's
    deviation from it; s is the noise of a usual sensor, 1.4 cm, so that it is in metres².
    """

    sees = None
    timed = (*Markers3D.timed, "segment")
    momentwise: ClassVar[bool] = False
    """Whether the energy is a sum over moments, which a banded Hessian can hold."""
    own: ErrorCovariance
    """Error of a point's position relative to the mean of all points."""
    path: ErrorCovariance
    """Error that all points have in common: that of their mean."""
    segment: Float[Tensor, "*batch moments points"]
    """Number of the stretch of time in which a point does not jump."""
    ground_known: bool = False

    def noise(self, guess: Any, body: BodyModel, given: float | None = None) -> Noise:
        """Return a constant noise; the energy uses its own covariances instead."""
        del guess, body, given
        return Noise(_SCALE, _SCALE)

    def robust_beyond(self, distance: float) -> "EstimatedPoints":
        """Return the sensor unchanged; its unreliable points are already hidden."""
        del distance
        return self

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Energy ½ s² Σ rᵀ C⁻¹ r (metres²) of the points' mean and of each point about it."""
        points, seen = self.expected(estimate)
        visible = self.visible[..., seen, :, None]
        away = (self.positions[..., seen, :, :] - points).where(visible, 0.0)
        common = away.sum(-2, keepdim=True) / visible.sum(-2, keepdim=True).clamp(min=1)
        own = (away - common).where(visible, 0.0)
        path, points = self._inverse_covariances
        path, points = path[..., seen, seen], points[..., seen, seen]
        slid = torch.einsum("...tpd,...pts,...spd->...", own, points, own)
        drifted = torch.einsum("...tpd,...ts,...spd->...", common, path, common)
        return 0.5 * _SCALE**2 * (slid + drifted)

    @cached_property
    def _inverse_covariances(
        self,
    ) -> tuple[
        Float[Tensor, "*batch moments moments"], Float[Tensor, "*batch points moments moments"]
    ]:
        """Inverse covariances over time: of the points' mean, and of each point about the mean."""
        like = self.positions
        infinite_error = torch.inf
        of_mean = torch.where(self.visible.any(-1), 1.0, infinite_error).to(like)
        of_points = torch.where(self.visible.mT, 1.0, infinite_error).to(like)
        one_segment = torch.zeros_like(of_mean)
        return (
            self.path.precision_matrix(of_mean, one_segment, self.fps),
            self.own.precision_matrix(of_points, self.segment.mT, self.fps),
        )

    def transformed(self, T_new_old: Float[np.ndarray, "4 4"]) -> "EstimatedPoints":
        """Return the sensor with its points moved to another frame of coordinates, metres."""
        if not np.isfinite(T_new_old).all():
            raise ObservationError("expected a rigid transform, got numbers that are not finite")
        return super().transformed(T_new_old)
