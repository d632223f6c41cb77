"""Types that energies take and return: a decoded motion, an estimate, an energy."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.core.motion import Motion
from recon.core.scene import Scene

REFERENCE_FPS = 30.0
"""Published weights multiply sums over frames at this rate; sums at other rates are scaled."""


@dataclass(frozen=True)
class Decoded:
    """The motion that a prior decoded from its variables, and the parts of their -log p."""

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
        """Return the body posed by the motion; a body that the prior posed already is reused."""
        if self.posed is not None and self.posed.model.same_as(model):
            return replace(self.posed, model=model)
        return model.pose(self.motion)


@dataclass(frozen=True)
class Estimate:
    """The current motion, its posed body and the scene: everything an energy may depend on."""

    decoded: Decoded
    body: PosedBody
    scene: Scene

    @classmethod
    def of_clip(cls, motion: Motion, body: BodyModel) -> "Estimate":
        """Return the estimate of a motion of one clip, as a batch of one, with a plain scene."""
        clip = motion[None]
        return cls(Decoded(clip), body.pose(clip), Scene.create(1, like=clip.translation))

    @property
    def motion(self) -> Motion:
        """The current motion."""
        return self.decoded.motion


Energy = Callable[[Estimate], Float[Tensor, "*batch"]]
"""One unweighted number per clip, in physical units; depends on no other clip of the batch."""


_FORMER = {
    "Prior": "recon.method.priors",
    "Sensor": "recon.method.sensor",
    "Observation": "recon.method.sensor",
}
"""Names that were here in version 0.2, with the modules where they are now."""


def __getattr__(name: str) -> Any:
    """Import on demand the names that plug-ins of version 0.2 import from this module."""
    if name in _FORMER:
        found = "Sensor" if name == "Observation" else name
        return getattr(import_module(_FORMER[name]), found)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
