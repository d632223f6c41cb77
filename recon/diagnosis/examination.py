"""The record that checks work on: one clip before its fit, and after it with what follows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, wraps
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.diagnosis.agreement import ResidualSummary, summarise
from recon.diagnosis.certainty import MOST, certainty, fitted_contacts
from recon.diagnosis.doubts import Alternative, alternatives, observed_joints
from recon.diagnosis.findings import NOTHING, Finding, Findings, in_turn
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions
from recon.method.laplace import Deviations
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor


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

    @cached_property
    def of_body(self) -> tuple[Finding, ...]:
        """What is odd about the fitted person's size and soles; two checks ask for it."""
        from recon.diagnosis.plausibility import body_warnings  # a fit without checks loads none

        return tuple(body_warnings(self.fit))

    @property
    def seen(self) -> Bool[Tensor, "time 22"]:
        """`observed` at the frames of the fitted motion."""
        return torch.from_numpy(self.observed[: self.motion.frames])

    def observed_at(self, motion: Motion) -> Bool[np.ndarray, "time 22"]:
        """`observed` at the frames of the fitted motion resampled to another rate."""
        return self.observed[self._frames(motion, len(self.observed))]

    def joint_std_at(self, motion: Motion) -> Float[Tensor, "time 22"] | None:
        """Standard deviations of a joint's coordinates at the frames of that motion, metres."""
        if self.deviations is None:
            return None
        joints = self.deviations.joints
        return joints[torch.from_numpy(self._frames(motion, len(joints)))].float().cpu()

    def angle_std_at(self, motion: Motion) -> Float[Tensor, "time angles"] | None:
        """Standard deviations of ISB angles at the frames of that motion, degrees."""
        if self.deviations is None or self.deviations.measures is None:
            return None
        angles = self.deviations.measures.clamp(max=MOST)
        return angles[torch.from_numpy(self._frames(motion, len(angles)))].float().cpu()

    def contact_probability_at(self, motion: Motion) -> Float[Tensor, "time 22"] | None:
        """How likely joints touch the ground in frames of that motion; None without a ground."""
        if not self.fit.grounded:
            return None
        contacts = fitted_contacts(self.fit, self.deviations)
        return contacts[torch.from_numpy(self._frames(motion, len(contacts)))].float()

    @property
    def ground_std(self) -> Float[Tensor, "2"] | None:
        """Standard deviations of a ground that was found: normal, radians, and height, metres."""
        ground = None if self.deviations is None else self.deviations.ground
        return None if ground is None else torch.tensor([ground.normal, ground.height])

    def _frames(self, motion: Motion, count: int) -> Int[np.ndarray, " time"]:
        """The fitted frame that is nearest to each of a motion's."""
        fitted = self.fit.result.motion
        times = motion.start_time + np.arange(motion.frames) / motion.fps
        frames = np.rint((times - fitted.start_time) * fitted.fps).astype(int)
        return np.clip(frames, 0, count - 1)


def _detached(fit: ClipFit) -> Estimate:
    return replace(fit.result.estimate, scene=fit.result.estimate.scene.detach())


BeforeFit = Callable[[CheckedClip], tuple[CheckedClip, Findings]]
AfterFit = Callable[[Examined], tuple[Examined, Findings]]
Check = BeforeFit | AfterFit
"""One thing that is looked for: the clip, put right where that is sure, and what was found."""


Clip = TypeVar("Clip", bound=CheckedClip)


def checked(clip: Clip, checks: Sequence[Callable[..., Any]]) -> Clip:
    """The clip after some checks, one after the other, with all that they found."""
    clip, found = in_turn(clip, checks)
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


def _marked(check: Any, sees: tuple[str, ...], comes_before_fit: bool) -> Any:
    @wraps(check)
    def asked(clip: Any) -> tuple[Any, Findings]:
        told = not sees or any(
            getattr(one, what, None) for one in clip.observations for what in sees
        )
        return check(clip) if told else (clip, NOTHING)

    asked.__dict__.update(sees=sees, comes_before_fit=comes_before_fit)
    return asked
