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
    """What a prior makes of its own variables."""

    motion: Motion
    energies: Mapping[str, Float[Tensor, "*batch"]] = field(default_factory=dict)
    """Named parts of -log p(variables), up to a constant."""
    contacts: Float[Tensor, "*batch time 22"] | None = None
    """Probability that a joint carries weight."""
    joints: Float[Tensor, "*batch time 22 3"] | None = None
    """The network's own joints, metres, where it predicts them beside the pose."""


@dataclass(frozen=True)
class Estimate:
    """All that an energy may look at."""

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
        """The motion as it stands."""
        return self.decoded.motion


Energy = Callable[[Estimate], Float[Tensor, "*batch"]]
"""One unweighted number per clip, in physical units; depends on no other clip of the batch."""


@runtime_checkable
class Prior(Protocol[S]):
    """A change of variables plus a density over them."""

    def encode(self, motion: Motion) -> S:
        """Variables that explain a motion as well as the prior can; axes (clips, ...)."""
        ...

    def decode(self, variables: S) -> Decoded:
        """The motion of the variables and how unlikely they are."""
        ...


@runtime_checkable
class Observation(Protocol):
    """Recorded data as an energy."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Misfit between the data and the estimate."""
        ...

    def residuals(self, estimate: Estimate) -> Residuals:
        """Observed minus predicted, by moment and by point, in the sensor's own unit."""
        ...

    def start(self, body: BodyModel) -> Motion:
        """A first guess from the data alone, at the data's own times."""
        ...
