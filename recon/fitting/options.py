"""How one clip is fitted, whatever it was read from."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from recon.core.errors import ReconError
from recon.fitting.priors import PriorObject, traits
from recon.method.shape_prior import ShapePrior
from recon.method.terms import Term


@dataclass(frozen=True)
class FitOptions:
    """The prior of a fit, the noise of the data, and what else the fit should heed."""

    prior: str | PriorObject = "humor"
    """A registered name, the place of a class, a loaded prior, or a method with `stages`."""
    weights: str = "open"
    """Weights of a prior that is given by its name: `open`, `nc` or a file."""
    method: str | None = None
    """One of the prior's `methods`, the ways in which it can be fitted; None is the usual one."""
    noise: tuple[float | None, ...] = ()
    """Standard deviation of each observation's coordinates in its own unit (metres, or pixels of
    keypoints); None, and an empty tuple, estimate it from the data."""
    physics: float = 0.0
    """Multiplier of the physics energies; 0 leaves them out."""
    ground_given: bool = False
    """Whether the caller gave the plane that lies at z = 0 of the recording."""
    grounded: bool = True
    """Whether there is a ground at all; there is none in water, on ropes and on stairs."""
    repair: bool = True
    """Whether faults of the data are repaired before the fit."""
    shape: Float[Tensor, " shape"] | None = None
    """Shape coefficients that are held; None estimates them."""
    shape_prior: ShapePrior | None = None
    """What is known of the shape, where it is not held."""
    terms: tuple[Term, ...] = ()
    """Further energies, added in every stage that moves poses."""

    def __post_init__(self) -> None:
        """Refuse to judge heights above a ground that is not there.

        Raises:
            ReconError: when the prior or physics need a ground and there is none.
        """
        if self.grounded:
            return
        if self.knows_gravity:
            name = self.prior if isinstance(self.prior, str) else type(self.prior).__name__
            raise ReconError(
                f"without a ground, nothing can be said about heights above it, which the prior "
                f"{name!r} judges; fit with the prior 'pose', or with one of your own whose "
                "traits are Traits(knows_gravity=False)"
            )
        if self.physics != 0:
            raise ReconError(
                f"physics is of a body on the ground, and there is none: expected physics=0, got "
                f"{self.physics:g}"
            )

    @property
    def completes(self) -> bool:
        """Whether the prior knows whole gait cycles, for which beginnings are searched."""
        return traits(self.prior).completes

    @property
    def knows_gravity(self) -> bool:
        """Whether the prior judges heights above the ground and which way is up."""
        return traits(self.prior).knows_gravity

    def noise_of(self, row: int) -> float | None:
        """The standard deviation given for an observation, by its number."""
        return self.noise[row] if self.noise else None
