"""The records that checks work on: one clip before its fit, and with the results after it."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import Noise, Unit
from recon.diagnosis.certainty import (
    MOST,
    AlternativeMotion,
    alternatives,
    certainty,
    fitted_contacts,
    observed_joints,
)
from recon.diagnosis.findings import NOTHING, Finding, Findings, run_checks
from recon.fitting.methods import FitOptions
from recon.fitting.records import ClipFit
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor

_QUANTILES = (0.5, 0.9, 0.99)


@dataclass(frozen=True)
class ResidualSummary:
    """Residuals of one sensor after the fit, summarised in the sensor's unit."""

    name: str
    unit: Unit
    noise: float
    """Standard deviation of the noise of a coordinate that the fit assumed."""
    median: float | None
    """Median length of all residuals; None where nothing was seen at the motion's times."""
    quantiles: tuple[float, ...] | None
    """The 50th, 90th and 99th percentile of the lengths of residuals."""
    by_point: dict[str, float | None]
    """Median length per named point; empty for clouds, whose points have no names."""
    by_frame: tuple[float | None, ...]
    """Median length per frame of the observation."""

    def report(self) -> dict[str, Any]:
        """Return the record as it stands in a report's list `residuals`."""
        return asdict(self)


def summarise(name: str, seen: Sensor, noise: Noise, estimate: Estimate) -> ResidualSummary:
    """Summarise one sensor's residuals of the first clip for the report."""
    with torch.no_grad():
        residuals = seen.residuals(estimate)
    seen_here = residuals.seen[0].numpy()
    lengths = np.where(seen_here, residuals.distances[0].double().numpy(), np.nan)
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
    """Return the median of the finite values of every row; None for rows without any."""
    known = [row[np.isfinite(row)] for row in rows]
    return [float(np.median(row)) if len(row) > 0 else None for row in known]


@dataclass(frozen=True, kw_only=True)
class CheckedClip:
    """The observations of one clip, and the findings of the checks so far."""

    observations: tuple[Sensor, ...]
    """Data of each sensor with a batch axis of length one, as repaired so far or as fitted."""
    names: tuple[str, ...]
    """Names of the sensors, for messages."""
    options: FitOptions
    body: BodyModel
    found: Findings = NOTHING
    belt: Float[Tensor, " 2"] | None = None
    """Velocity (m/s) of a treadmill's belt in the recording, with which the frame of the fit
    moves; None where feet stand in the room."""
    start: Motion | None = None
    """A motion (1, time) in the recording's frame with which the fit begins, found by a check of
    the data; None where none was found."""

    @property
    def repairs(self) -> tuple[Finding, ...]:
        """Faults of the data that were repaired before the fit."""
        return tuple(self.found.repairs)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that should be read before the result is used."""
        return tuple(self.found.warnings)

    @property
    def diagnosis(self) -> tuple[Finding, ...]:
        """Findings that are no fault, such as inferred limbs, steps or seats."""
        return tuple(self.found.diagnosis)


@dataclass(frozen=True, kw_only=True)
class ExaminedClip(CheckedClip):
    """One clip with its fit, residuals, uncertainty and findings."""

    fit: ClipFit
    estimate: Estimate
    """The fitted motion and scene, without derivatives."""
    motion: Motion
    """The fitted motion at the fit's own frames."""
    residuals: tuple[ResidualSummary, ...]
    """Residuals of every sensor, in the order of the observations."""
    observed: Bool[np.ndarray, "time 22"]
    """False where a joint of the fitted motion was inferred rather than seen."""
    deviations: Deviations | None
    """Standard deviations of joints, root and shape; None where the prior has no density."""
    alternatives: tuple[AlternativeMotion, ...]
    """Other motions that the fit compared with the one it gives, the likeliest first."""

    @classmethod
    def of(cls, clip: CheckedClip, fit: ClipFit) -> "ExaminedClip":
        """Return a clip with the results of its fit, which no check has examined yet."""
        detached_estimate = replace(fit.result.estimate, scene=fit.result.estimate.scene.detach())
        sensors = zip(clip.names, fit.observations, fit.noises, strict=True)
        return cls(
            **{**vars(clip), "observations": fit.observations},
            fit=fit,
            estimate=detached_estimate,
            motion=fit.result.clip(0).detach(),
            residuals=tuple(summarise(*sensor, detached_estimate) for sensor in sensors),
            observed=observed_joints(fit.observations, detached_estimate),
            deviations=certainty(fit),
            alternatives=alternatives(fit),
        )

    @property
    def ratio(self) -> float:
        """Frames of the first sensor's data per frame of the fitted motion."""
        return self.observations[0].fps / self.motion.fps

    @property
    def seen(self) -> Bool[Tensor, "time 22"]:
        """Mask of the joints that were observed, for the frames of the fitted motion."""
        return torch.from_numpy(self.observed[: self.motion.frames])

    def results_at_frames_of(self, motion: Motion) -> dict[str, Tensor | None]:
        """Return per-frame results (observed joints, contacts, deviations) at a motion's frames.

        The keys are those of `MotionFile`: `observed`; the standard deviations `joint_std` (m),
        `angle_std` of ISB angles (degrees) and `ground_std` of a ground that was found (normal in
        radians, height in metres); and `contact_probability`. Values are None where unknown.
        """
        fitted, known = self.fit.result.motion, self.deviations
        times = motion.start_time + np.arange(motion.frames) / motion.fps
        frames = torch.from_numpy(np.rint((times - fitted.start_time) * fitted.fps).astype(int))
        ground = None if known is None else known.ground
        angles = None if known is None else known.measures
        values = {
            "observed": torch.from_numpy(self.observed),
            "joint_std": None if known is None else known.joints.float(),
            "angle_std": None if angles is None else angles.clamp(max=MOST).float(),
            "contact_probability": (
                fitted_contacts(self.fit, known).float() if self.fit.grounded else None
            ),
        }
        return {
            "ground_std": None if ground is None else torch.tensor([ground.normal, ground.height]),
            **{
                name: None if one is None else one[frames.clamp(0, len(one) - 1)]
                for name, one in values.items()
            },
        }


BeforeFit = Callable[[CheckedClip], tuple[CheckedClip, Findings]]
AfterFit = Callable[[ExaminedClip], tuple[ExaminedClip, Findings]]
Check = BeforeFit | AfterFit
"""Looks for one fault: takes the clip, returns it (repaired where certain) with the findings."""


Clip = TypeVar("Clip", bound=CheckedClip)


def checked(clip: Clip, checks: Sequence[Callable[..., Any]]) -> Clip:
    """Run the checks one after the other; return the clip with all their findings.

    A check that was declared for kinds of sensors is skipped for clips without these.
    """
    kinds = ("named", "view", "cloud")
    given = {kind for one in clip.observations for kind in kinds if getattr(one, kind, None)}
    given.add("any")
    suited = [one for one in checks if given.intersection(getattr(one, "sees", ()) or ("any",))]
    clip, found = run_checks(clip, suited)
    return replace(clip, found=clip.found + found)


def before_fit(*sensor_kinds: str) -> Callable[[BeforeFit], BeforeFit]:
    """Decorate a function as a check of the data before the fit, which may repair them.

    Args:
        sensor_kinds: kinds of sensors that the check needs, `named`, `view` or `cloud`; it is
            skipped for clips without any of them. With no kinds, it runs for every clip.
    """
    return partial(_with_attributes, sees=sensor_kinds, comes_before_fit=True)


def after_fit(*sensor_kinds: str) -> Callable[[AfterFit], AfterFit]:
    """Decorate a function as a check of the fit of clips with some of these kinds of sensors."""
    return partial(_with_attributes, sees=sensor_kinds, comes_before_fit=False)


def _with_attributes(check: Any, **attributes: Any) -> Any:
    vars(check).update(attributes)
    return check
