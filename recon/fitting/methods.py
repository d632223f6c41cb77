"""The options of a fit, and functions that load its prior by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ReconError, WeightsError
from recon.core.plugins import LOOKS, PRIORS, imported_object, registered_places
from recon.method.priors import PriorLike, as_prior, is_prior, trait
from recon.method.terms import Term

if TYPE_CHECKING:
    from recon.method.shape_prior import ShapePrior
else:  # at run time Any replaces ShapePrior, whose module most fits need not import
    from typing import Any as ShapePrior

Method = str | Callable[..., Any]
"""A way to fit a prior, or a network for previews: its name, "package.module:Class", or itself."""


def prior_class(prior: str) -> Any:
    """Return the class of a prior, by its registered name or by "package.module:Class".

    Raises:
        WeightsError: when there is no such prior.
    """
    known = registered_places(PRIORS)
    if prior not in known and ":" not in prior:
        raise WeightsError(
            f"prior: expected {', '.join(known)} or 'package.module:Class', got {prior!r}"
        )
    try:
        return imported_object(known.get(prior, prior), "prior")
    except ReconError as error:
        raise WeightsError(str(error)) from error


def loaded_prior(prior: str | PriorLike, weights: str, body: BodyModel) -> Any:
    """Return the prior, loaded with its weights; an object is returned as it is.

    A class is loaded by `load(weights, body)`; without such a method it is made without arguments.

    Raises:
        FileNotFoundError: when there are no such weights.
        WeightsError: when there is no such prior, or it takes no weights.
    """
    found = prior
    if isinstance(prior, str):
        kind = prior_class(prior)
        if missing := sorted(getattr(kind, "__abstractmethods__", ())):
            raise WeightsError(
                f"prior: {prior!r} lacks {' and '.join(missing)}, which every recon.method.Prior "
                "defines; add what is missing"
            )
        if hasattr(kind, "load"):
            found = kind.load(weights, body)
        elif weights == "open":
            found = kind()
        else:
            raise WeightsError(
                f"weights: the prior {prior!r} takes none, as it has no method load(weights, body)"
            )
    if is_prior(found):
        return as_prior(found)
    if prior_trait(found, "completes"):
        return found
    raise WeightsError(
        f"prior: {prior!r} is no recon.method.Prior and has no method stages(data), got a "
        f"{type(found).__name__}"
    )


def prior_trait(prior: str | PriorLike, name: str) -> bool:
    """Return the trait `knows_gravity` or `completes` of a prior, without loading its weights."""
    return trait(prior_class(prior) if isinstance(prior, str) else prior, name)


def is_preview(method: Method | None) -> bool:
    """Whether a method is a network that proposes motions, rather than a way to fit a prior."""
    if isinstance(method, str):
        return ":" in method or method in registered_places(LOOKS)
    return method is not None


def checked_method(prior: str | PriorLike, name: Method | None) -> str | None:
    """Return the name of a way to fit a prior, one of its `methods`, or None for the default.

    Raises:
        ReconError: when the prior has no such method.
    """
    if name is None or is_preview(name):
        return None
    known = list(getattr(prior_class(prior) if isinstance(prior, str) else prior, "methods", ()))
    if name in known:
        return name
    prior_name = repr(prior) if isinstance(prior, str) else f"a {type(prior).__name__}"
    if len(known) == 0:
        raise ReconError(f"method: {prior_name} is fitted in one way only, got {name!r}; omit it")
    methods = " or ".join((*known, *registered_places(LOOKS)))
    raise ReconError(f"method: {prior_name} is fitted by {methods}, got {name!r}")


@dataclass(frozen=True)
class FitOptions:
    """Prior of a fit, noise of the data, known shape and ground, and further energies."""

    prior: str | PriorLike = "humor"
    """A registered name, the place "package.module:Class" of a class, or a loaded prior."""
    weights: str = "open"
    """Weights of a prior that is given by its name: `open` or a file."""
    method: Method | None = None
    """One of the prior's `methods`, or a network that gives a preview; None is the default way."""
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
    """Mean and covariance of the shape, where it is not held."""
    terms: tuple[Term, ...] = ()
    """Further energies, added in every stage that moves poses."""
    device: str = "cpu"
    """Device on which stages are minimised; all other steps run on the processor."""

    def __post_init__(self) -> None:
        """Refuse priors that depend on the height above the ground when there is no ground.

        Raises:
            ReconError: when the prior or physics need a ground and there is none.
        """
        if self.grounded:
            return
        if self.knows_gravity:
            name = self.prior if isinstance(self.prior, str) else type(self.prior).__name__
            raise ReconError(
                f"the prior {name!r} needs the ground, as it depends on heights above it, and "
                "ground is None; fit with the prior 'pose', or with a prior whose knows_gravity "
                "is False"
            )
        if self.physics != 0:
            raise ReconError(
                f"physics needs the ground, and ground is None: expected physics=0, got "
                f"{self.physics:g}"
            )

    @property
    def completes(self) -> bool:
        """Whether the prior is of whole gait cycles, which are searched from many starts."""
        return prior_trait(self.prior, "completes")

    @property
    def knows_gravity(self) -> bool:
        """Whether the prior judges heights above the ground and which way is up."""
        return prior_trait(self.prior, "knows_gravity")

    @property
    def starting_shape(self) -> Float[Tensor, " shape"] | None:
        """Shape coefficients that a fit starts from; None where none are known."""
        if self.shape is None and self.shape_prior is not None:
            return self.shape_prior.mean
        return self.shape

    def noise_of(self, row: int) -> float | None:
        """Return the standard deviation given for an observation, by its number; else None."""
        return self.noise[row] if self.noise else None
