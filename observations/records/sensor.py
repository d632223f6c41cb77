"""What sensors have in common: a clock, an energy from residuals, stretches of time."""

from abc import abstractmethod
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.start.standing import standing
from observations.timing import moment_numbers
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.residuals import Noise, Residuals, Unit
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate

R = TypeVar("R", bound="SensorRecord")


class SensorRecord(TensorStruct):
    """A sensor's data with usual answers to what a fit asks; see `recon.method.protocols.Sensor`.

    A sensor is a frozen dataclass that derives from this one. It adds its data, the fields below,
    `shown`, `residuals`, `typical_noise` and `timed`, and overrides whatever it knows better.
    """

    unit: ClassVar[Unit] = "metres"
    sees: ClassVar[Literal["points", "image", "surface"] | None] = None
    """By which first guesses and checks the data are taken: as those of named points in space, of
    their images, or of points anywhere on the surface; None for others, as those of a sensor of
    your own."""
    level: bool = False
    """Whether the z axis of the recording's frame points up even where its ground is not known."""
    timed: ClassVar[tuple[str, ...]] = ()
    """Names of the tensors that have an axis of moments, the first one after that of clips; where
    there are no data, they are zero, and `shown` is then false."""
    typical_noise: ClassVar[tuple[float, float]]
    """Standard deviation of a residual's coordinate where nobody gives one: in `unit`, and what
    that is at the body in metres."""
    fps: float
    start_time: float
    ground_known: bool

    @property
    @abstractmethod
    def shown(self) -> Bool[Tensor, "*batch moments points"]:
        """Which points were seen at every moment."""

    @abstractmethod
    def residuals(self, estimate: Estimate) -> Residuals:
        """Observed minus predicted, by moment and by point, in `unit`."""

    @property
    def kind(self) -> str:
        """The sensor's name in reports."""
        return type(self).__name__.lower()

    @property
    def clips(self) -> tuple[int, ...]:
        """Sizes of the leading axes; one axis of clips, or none."""
        return tuple(self.shown.shape[:-2])

    @property
    def moments(self) -> int:
        """Number of moments of a clip."""
        return self.shown.shape[-2]

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ w² |observed - predicted|², taken at 30 Hz; `unit` squared."""
        found = self.residuals(estimate)
        squared = (found.weights[..., None] * found.values).square().sum((-3, -2, -1))
        return 0.5 * squared * (REFERENCE_FPS / self.fps)

    def point_names(self, body: BodyModel) -> tuple[str, ...]:
        """No names."""
        del body
        return ()

    def shown_joints(self, estimate: Estimate) -> Bool[np.ndarray, "moments 22"]:
        """The places of no joints."""
        return np.zeros((self.moments, estimate.body.joints.shape[-2]), dtype=bool)

    def noise(self, guess: Motion, body: BodyModel, given: float | None = None) -> Noise:
        """The standard deviation that is given, or `typical_noise`."""
        del guess, body
        own, metres = self.typical_noise
        return Noise(own, metres) if given is None else Noise(given, given * metres / own)

    def start(self, body: BodyModel) -> Motion:
        """A person who stands at the origin, for data that tell no place."""
        return standing(body, self.clips, self.moments, fps=self.fps, start_time=self.start_time)

    def window(self: R, start: float, stop: float) -> R:
        """What was seen from one time to another, both included, seconds; the clock goes on."""
        clock = {"fps": self.fps, "start_time": self.start_time, "start": start, "stop": stop}
        numbers = moment_numbers(**clock)
        first: dict[str, Any] = {"start_time": self.start_time + numbers.start / self.fps}
        return self.derived(**first, **self._moments(numbers))

    def coarse(self: R, body: BodyModel, step: int = 2) -> R:
        """Every `step`-th moment."""
        del body
        fewer: dict[str, Any] = {"fps": self.fps / step}
        return self.derived(**fewer, **self._moments(range(0, self.moments, step)))

    def thinned(self: R, most: int) -> R:
        """All points: each means something."""
        del most
        return self

    def transformed(self: R, T_new_old: Float[np.ndarray, "4 4"]) -> R:
        """Refused: nobody knows how these data change with the frame that they are given in."""
        del T_new_old
        raise ObservationError(
            f"{type(self).__name__} cannot be given in another frame: write a method "
            "transformed(T_new_old), or fit it with a ground that is known"
        )

    def robust_beyond(self: R, distance: float) -> R:
        """Itself: these residuals are no distances of named points."""
        del distance
        return self

    def _moments(self, numbers: range) -> dict[str, Tensor]:
        """The tensors with an axis of moments at some of them; zero where there are none."""
        axis = len(self.clips)
        number = torch.tensor(numbers, dtype=torch.long)
        exists = (number >= 0) & (number < self.moments)
        found: dict[str, Tensor] = {}
        for name in self.timed:
            tensor: Tensor = getattr(self, name)
            there = number.clamp(0, self.moments - 1).to(tensor.device)
            shape = (-1, *(1,) * (tensor.ndim - axis - 1))
            seen = exists.to(tensor.device).reshape(shape)
            found[name] = tensor.index_select(axis, there) * seen
        return found
