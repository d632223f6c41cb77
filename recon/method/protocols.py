"""The seams: what a prior, an observation and an energy are to the rest of the library."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.core.motion import Motion
from recon.core.residuals import Residuals
from recon.core.scene import Scene
from recon.core.struct import S

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


@runtime_checkable
class Prior(Protocol[S]):
    """A change of variables with a density over them."""

    def encode(self, motion: Motion) -> S:
        """Variables of the motion nearest to the given one; axes (clips, ...)."""
        ...

    def decode(self, variables: S) -> Decoded:
        """The motion of the variables, and the parts of -log p of the variables."""
        ...


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
