"""The seams: what a prior and an energy are to the rest of the library; see `sensor` as well."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.core.motion import Motion
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
class Density(Protocol):
    """What a method believes of a motion without data, as residuals of unit variance.

    -log p = ½ Σ |z|² + ½ acceleration Σ |second difference of a joint|² + ½ shape |betas|²,
    sums over frames at 30 Hz.
    """

    @property
    def acceleration(self) -> float:
        """Inverse variance of a joint coordinate's second differences at 30 Hz, 1 / metres²."""
        ...

    @property
    def shape(self) -> float:
        """Inverse variance of a shape coefficient, for every frame."""
        ...

    def by_rotations(self, motion: Motion) -> Float[Tensor, "*batch time coordinates 63"]:
        """Derivatives of a pose's coordinates of unit variance by the joints' rotation steps.

        The steps are those of all joints but the root, R_j Exp(w_j), radians.
        """
        ...


def __getattr__(name: str) -> Any:
    """Sensors' class under the names that plug-ins of 0.2.0 import from here."""
    if name in ("Sensor", "Observation"):
        from recon.method.sensor import Sensor

        return Sensor
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
