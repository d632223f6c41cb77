"""The seams: what an estimate, an energy and an observation are to the rest of the library."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.core.motion import Motion
from recon.core.residuals import Noise, Residuals, Unit
from recon.core.scene import Scene

REFERENCE_FPS = 30.0
"""Published weights multiply sums over frames at this rate; sums at other rates are scaled."""


@dataclass(frozen=True)
class Decoded:
    """The motion that a prior decodes from its variables, and its energies."""

    motion: Motion
    energies: Mapping[str, Float[Tensor, "*batch"]] = field(default_factory=dict)
    """Named parts of -log p(variables), up to a constant."""
    contacts: Float[Tensor, "*batch time 22"] | None = None
    """Probability, from 0 to 1, that a joint is in contact with the ground."""
    joints: Float[Tensor, "*batch time 22 3"] | None = None
    """Joints that the prior's network predicts beside the pose, metres; None if it does not."""
    posed: PosedBody | None = None
    """The body in that motion, where the prior posed one itself."""

    def body(self, model: BodyModel) -> PosedBody:
        """The model in the motion; posed only where the prior has not posed this model already."""
        if self.posed is not None and self.posed.model is model:
            return self.posed
        return model.pose(self.motion)


@dataclass(frozen=True)
class Estimate:
    """The current motion, its posed body and the scene: everything an energy may depend on."""

    decoded: Decoded
    body: PosedBody
    scene: Scene

    @classmethod
    def of_clip(cls, motion: Motion, body: BodyModel) -> "Estimate":
        """A finished motion of one clip (no batch axis) as a batch of one, for observations."""
        clip = motion.map(lambda tensor: tensor[None])
        return cls(Decoded(clip), body.pose(clip), Scene.create(1, like=clip.translation))

    @property
    def motion(self) -> Motion:
        """The current motion."""
        return self.decoded.motion


Energy = Callable[[Estimate], Float[Tensor, "*batch"]]
"""One unweighted number per clip, in physical units; depends on no other clip of the batch."""

Observed = TypeVar("Observed", bound="Sensor")


@runtime_checkable
class Observation(Protocol):
    """Data of one sensor, and the energy that compares them with an estimate."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Half the sum of squared residuals, one number per clip, in the sensor's unit squared."""
        ...

    def residuals(self, estimate: Estimate) -> Residuals:
        """Observed minus predicted, by moment and by point, in the sensor's own unit."""
        ...

    def start(self, body: BodyModel) -> Motion:
        """A first guess from the data alone, at the data's own times."""
        ...


@runtime_checkable
class TrackedJoints(Protocol):
    """An observation of points that tell where joints are, in space or in an image."""

    unit: ClassVar[Unit]
    """Metres in space, pixels in an image."""

    def told_joints(self, body: BodyModel) -> Float[Tensor, "*batch 22"]:
        """Share of the moments in which the place of each joint is told."""
        ...


@runtime_checkable
class Sensor(Observation, Protocol):
    """An observation with all that a fit asks of it; one more sensor is one class with these.

    `observations.records.sensor.SensorRecord` has usual answers to derive from. A sensor is a
    frozen record of tensors (`recon.core.struct.TensorStruct`) with a leading axis of clips. In
    its own frame, that of the recording, z = 0 may be the ground.
    """

    unit: ClassVar[Unit]
    """The unit of its residuals."""

    @property
    def level(self) -> bool:
        """Whether the recording's z axis points up even where its ground is not known."""
        ...

    @property
    def kind(self) -> str:
        """The sensor's name in reports."""
        ...

    @property
    def fps(self) -> float:
        """Moments per second."""
        ...

    @property
    def start_time(self) -> float:
        """Seconds, on the clock that all sensors of a clip share."""
        ...

    @property
    def ground_known(self) -> bool:
        """Whether z = 0 of the recording's frame is the ground."""
        ...

    @property
    def clips(self) -> tuple[int, ...]:
        """Sizes of the leading axes; one axis of clips, or none."""
        ...

    @property
    def moments(self) -> int:
        """Number of moments of a clip."""
        ...

    @property
    def shown(self) -> Bool[Tensor, "*batch moments points"]:
        """Which points were seen at every moment."""
        ...

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """Names of the points, for reports; none where points come in no order."""
        ...

    def shown_joints(self, estimate: Estimate) -> Bool[np.ndarray, "moments 22"]:
        """Joints of the first clip whose place the sensor tells, at every moment."""
        ...

    def noise(self, guess: Motion, body: BodyModel, given: float | None = None) -> Noise:
        """How noisy the data are: as given, in `unit`, or estimated from the data alone."""
        ...

    def window(self: Observed, start: float, stop: float) -> Observed:
        """What was seen from one time to another, both included, seconds; the clock goes on."""
        ...

    def coarse(self: Observed, body: BodyModel, step: int = 2) -> Observed:
        """Fewer moments and points, for a quick comparison of hypotheses."""
        ...

    def thinned(self: Observed, most: int) -> Observed:
        """Few points of every moment, at most so many, where points come in no order."""
        ...

    def transformed(self: Observed, T_new_old: Float[np.ndarray, "4 4"]) -> Observed:
        """Data after a rigid transform of the frame that they are given in, metres."""
        ...

    def robust_beyond(self: Observed, distance: float) -> Observed:
        """Points count ever less beyond so many metres; where they do not yet and have names."""
        ...

    def derived(self: Observed, **fields: Any) -> Observed:
        """The record with some fields exchanged, unchecked."""
        ...

    def to(self: Observed, *, device: Any = None, dtype: Any = None) -> Observed:
        """The record on another device, in another precision."""
        ...

    def __getitem__(self: Observed, index: Any) -> Observed:
        """Some clips, or with None one more leading axis."""
        ...

    def detach(self: Observed) -> Observed:
        """Cut from the graph that computed it."""
        ...


def __getattr__(name: str) -> Any:
    """`Prior`, which lived here in version 0.2."""
    if name == "Prior":
        return import_module("recon.method.priors").Prior
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
