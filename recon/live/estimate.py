"""What a stream tells about one moment."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from recon.diagnosis.findings import Finding


@dataclass(frozen=True)
class LiveEstimate:
    """The body at one moment, final: later pushes do not change it."""

    time: float
    """Time of the moment, seconds on the clock of the observations."""
    translation: Float[Tensor, "3"]
    """SMPL translation, metres."""
    rotations: Float[Tensor, "22 3 3"]
    """Rotation of every joint relative to its parent; the first is the root in the world."""
    joints: Float[Tensor, "22 3"]
    """Places of the joints in the world, metres."""
    shape: Float[Tensor, " shape"]
    """Shape coefficients as they are known by now."""
    observed: Bool[Tensor, " 22"]
    """Joints whose place an observation of this moment tells."""
    contacts: Float[Tensor, " 22"] | None
    """Probability that a joint touches the ground, by its height and speed; None under the pose
    prior, which knows no ground."""
    earlier: tuple["LiveEstimate", ...] = ()
    """Estimates of moments before this one that became final at the same time: those of the
    beginning, and moments that the sensor dropped."""
    findings: tuple[Finding, ...] = ()
    """What was noticed in the data since the estimate before: late, dropped and unusable moments,
    jumps of the clock, points in impossible places, the person leaving and returning."""

    @property
    def every(self) -> tuple["LiveEstimate", ...]:
        """The earlier estimates and this one, in the order of time."""
        return (*self.earlier, self)
