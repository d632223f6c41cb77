"""Networks that look once at the observations of a clip and propose whole motions.

A look is any function of observations and a body that returns `ProposedMotions`:
`recon.fit(..., method=look)` gives its likeliest motion as a preview.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion

if TYPE_CHECKING:
    from recon.method.sensor import Sensor
else:  # at run time Any replaces Sensor, whose module need not be imported
    from typing import Any as Sensor


@dataclass(frozen=True)
class ProposedMotions:
    """Motions that a network proposes for one clip, in the world of the observations."""

    motions: Motion
    """Axes (hypotheses, time): z up, metres, at any frame rate, over the time of the data."""
    log_weight: Float[Tensor, " hypotheses"]
    """Logarithm of how likely each is, up to a constant."""
    joint_std: Float[Tensor, "hypotheses time 22"] | None = None
    """Standard deviation of every coordinate of a joint, metres; None where it is not known."""
    doubt: str | None = None
    """Why the data are far from what the network knows, as a sentence for the user; None where
    they are not."""

    @property
    def likeliest(self) -> int:
        """Index of the proposed motion with the largest weight."""
        return int(self.log_weight.argmax())

    def check(self, name: str) -> None:
        """Refuse a network's result that has wrong axes, or numbers that are not finite.

        Args:
            name: of the network, for messages.

        Raises:
            ReconError: saying what was expected and what came.
        """
        if not isinstance(self, ProposedMotions):
            raise ReconError(
                f"{name}: expected recon.method.ProposedMotions, got {type(self).__name__}"
            )
        motions = self.motions
        if motions.translation.ndim != 3 or self.log_weight.shape != motions.translation.shape[:1]:
            raise ReconError(
                f"{name}: expected motions with axes (hypotheses, time) and a weight for each, "
                f"got translation of {tuple(motions.translation.shape)} and "
                f"{tuple(self.log_weight.shape)} weights"
            )
        if self.joint_std is not None and self.joint_std.shape != motions.rotations.shape[:-2]:
            raise ReconError(
                f"{name}: expected joint_std of {tuple(motions.rotations.shape[:-2])}, got "
                f"{tuple(self.joint_std.shape)}"
            )
        given = {"log_weight": self.log_weight, "joint_std": self.joint_std, **motions.tensors()}
        for field, tensor in given.items():
            if tensor is not None and not bool(torch.isfinite(tensor).all()):
                raise ReconError(f"{name}: {field} holds NaN or infinity")


Look = Callable[[Sequence[Sensor], BodyModel], ProposedMotions]
"""Called with the observations of one clip, without an axis of clips, in a world whose z = 0 is
the ground, and the body whose motion it is.

Raises `recon.core.errors.ObservationError` for observations that it cannot see, and says what to
do. A class of one may have a class method `load(weights, body)`, as priors have.
"""
