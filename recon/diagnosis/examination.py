"""The record that checks work on: one clip before its fit, and after it with what follows."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import Noise, Unit
from recon.diagnosis.certainty import MOST, certainty, fitted_contacts
from recon.diagnosis.doubts import Alternative, alternatives, observed_joints
from recon.diagnosis.findings import NOTHING, Finding, Findings, in_turn
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor

_QUANTILES = (0.5, 0.9, 0.99)


@dataclass(frozen=True)
class ResidualSummary:
    """How far one sensor's data are from the fitted body, in the sensor's own unit."""

    name: str
    unit: Unit
    noise: float
    """Standard deviation of a coordinate that the fit assumed."""
    median: float | None
    """Median length of all residuals; None where nothing was seen at the motion's times."""
    quantiles: tuple[float, ...] | None
    """The 50th, 90th and 99th percentile."""
    by_point: dict[str, float | None]
    """Median of every named point; empty for clouds, whose points have no names."""
    by_frame: tuple[float | None, ...]
    """Median of every moment of the observation."""

    def report(self) -> dict[str, Any]:
        """The record as it stands in a report's list `residuals`."""
        return asdict(self)


def summarise(name: str, seen: Sensor, noise: Noise, estimate: Estimate) -> ResidualSummary:
    """Numbers about the residuals of the first clip for its report."""
    with torch.no_grad():
        residuals = seen.residuals(estimate)
    seen_here = residuals.seen[0].cpu().numpy()
    lengths = np.where(seen_here, residuals.distances[0].double().cpu().numpy(), np.nan)
    flat = lengths[np.isfinite(lengths)]
    names = seen.point_names(estimate.body.model)
    return ResidualSummary(
        name=name,
        unit=residuals.unit,
        noise=noise.own,
        median=float(np.median(flat)) if len(flat) > 0 else None,
        quantiles=tuple(np.quantile(flat, _QUANTILES).tolist()) if len(flat) > 0 else None,
        by_point=dict(zip(names, _medians(lengths.T), strict=True)) if names else {},
        by_frame=tuple(_medians(lengths)),
    )


def _medians(rows: Float[np.ndarray, "rows samples"]) -> list[float | None]:
    """Median of the finite values of every row."""
    known = [row[np.isfinite(row)] for row in rows]
    return [float(np.median(row)) if len(row) > 0 else None for row in known]


@dataclass(frozen=True, kw_only=True)
class CheckedClip:
    """What sensors saw of one clip, as far as it was checked."""

    observations: tuple[Sensor, ...]
    """As they should be fitted, then as they were; a batch axis of length one."""
    names: tuple[str, ...]
    """Names of the sensors, for messages."""
    options: FitOptions
    body: BodyModel
    found: Findings = NOTHING
    belt: Float[Tensor, " 2"] | None = None
    """Velocity of the treadmill in the recording, m/s; the fit is in the frame that moves with
    it. None where feet stand in the room."""

    @property
    def repairs(self) -> tuple[Finding, ...]:
        """What was wrong with the data and was put right before the fit."""
        return tuple(self.found.repairs)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What should be read before the result is used."""
        return tuple(self.found.warnings)

    @property
    def diagnosis(self) -> tuple[Finding, ...]:
        """What is worth knowing but is no fault: limbs that were inferred, steps, seats."""
        return tuple(self.found.diagnosis)


@dataclass(frozen=True, kw_only=True)
class Examined(CheckedClip):
    """A clip with its fit, and what is known about the data and the result."""

    fit: ClipFit
    residuals: tuple[ResidualSummary, ...]
    """Residuals of every sensor, in the order of the observations."""
    observed: Bool[np.ndarray, "time 22"]
    """False where a joint of the fitted motion was inferred rather than seen."""
    deviations: Deviations | None
    """Standard deviations of joints, root and shape; None where the prior has no density."""
    alternatives: tuple[Alternative, ...]
    """Other motions that the fit compared with the one it gives, the likeliest first."""

    @classmethod
    def of(cls, clip: CheckedClip, fit: ClipFit) -> "Examined":
        """A clip after its fit, without further checks."""
        here = _detached(fit)
        sensors = zip(clip.names, fit.observations, fit.noises, strict=True)
        return cls(
            **{**vars(clip), "observations": fit.observations},
            fit=fit,
            residuals=tuple(summarise(*sensor, here) for sensor in sensors),
            observed=observed_joints(fit.observations, here),
            deviations=certainty(fit),
            alternatives=alternatives(fit),
        )

    @cached_property
    def estimate(self) -> Estimate:
        """The fitted motion and scene, without derivatives."""
        return _detached(self.fit)

    @cached_property
    def motion(self) -> Motion:
        """The fitted motion on the processor, at the fit's own frames."""
        return self.fit.result.clip(0).detach().to(device="cpu")

    @property
    def model(self) -> BodyModel:
        """The fitted body on the processor."""
        return self.estimate.body.model.to(device="cpu")

    @property
    def seen(self) -> Bool[Tensor, "time 22"]:
        """`observed` at the frames of the fitted motion."""
        return torch.from_numpy(self.observed[: self.motion.frames])

    def observed_at(self, motion: Motion) -> Bool[np.ndarray, "time 22"]:
        """`observed` at the frames of the fitted motion resampled to another rate."""
        return self._at(motion, torch.from_numpy(self.observed)).numpy()

    def joint_std_at(self, motion: Motion) -> Float[Tensor, "time 22"] | None:
        """Standard deviations of a joint's coordinates at the frames of that motion, metres."""
        if self.deviations is None:
            return None
        return self._at(motion, self.deviations.joints.float())

    def angle_std_at(self, motion: Motion) -> Float[Tensor, "time angles"] | None:
        """Standard deviations of ISB angles at the frames of that motion, degrees."""
        if self.deviations is None or self.deviations.measures is None:
            return None
        return self._at(motion, self.deviations.measures.clamp(max=MOST).float())

    def contact_probability_at(self, motion: Motion) -> Float[Tensor, "time 22"] | None:
        """How likely joints touch the ground in frames of that motion; None without a ground."""
        if not self.fit.grounded:
            return None
        return self._at(motion, fitted_contacts(self.fit, self.deviations).float())

    @property
    def ground_std(self) -> Float[Tensor, "2"] | None:
        """Standard deviations of a ground that was found: normal, radians, and height, metres."""
        ground = None if self.deviations is None else self.deviations.ground
        return None if ground is None else torch.tensor([ground.normal, ground.height])

    def _at(self, motion: Motion, values: Tensor) -> Tensor:
        """Values of the fitted frames that are nearest to each of a motion's frames."""
        fitted = self.fit.result.motion
        times = motion.start_time + np.arange(motion.frames) / motion.fps
        frames = np.rint((times - fitted.start_time) * fitted.fps).astype(int)
        return values[torch.from_numpy(np.clip(frames, 0, len(values) - 1))].cpu()


def _detached(fit: ClipFit) -> Estimate:
    return replace(fit.result.estimate, scene=fit.result.estimate.scene.detach())


BeforeFit = Callable[[CheckedClip], tuple[CheckedClip, Findings]]
AfterFit = Callable[[Examined], tuple[Examined, Findings]]
Check = BeforeFit | AfterFit
"""One thing that is looked for: the clip, put right where that is sure, and what was found."""


Clip = TypeVar("Clip", bound=CheckedClip)


def checked(clip: Clip, checks: Sequence[Callable[..., Any]]) -> Clip:
    """The clip after some checks, one after the other, with all that they found.

    A check that names what it `sees` is not asked about clips without such sensors.
    """

    def concerned(check: Callable[..., Any]) -> bool:
        sees = getattr(check, "sees", ())
        return not sees or any(getattr(one, k, None) for one in clip.observations for k in sees)

    clip, found = in_turn(clip, [check for check in checks if concerned(check)])
    return replace(clip, found=clip.found + found)


def before_fit(*sees: str) -> Callable[[BeforeFit], BeforeFit]:
    """A check of the data, which may put them right.

    Args:
        sees: properties of the sensors that it speaks of, `named`, `view` or `cloud`; the check is
            not asked about clips without such. None of them: it speaks of any sensor.
    """
    return partial(_marked, sees=sees, comes_before_fit=True)


def after_fit(*sees: str) -> Callable[[AfterFit], AfterFit]:
    """A check of a fit; `sees` as of `before_fit`."""
    return partial(_marked, sees=sees, comes_before_fit=False)


def _marked(check: Any, **marks: Any) -> Any:
    vars(check).update(marks)
    return check
