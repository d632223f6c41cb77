"""What a fit asks of a prior; whoever keeps one of these protocols can be given to `recon.fit`."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.struct import TensorStruct
from recon.method.protocols import Prior
from recon.method.reconstruction import Method
from recon.method.stages import Stage
from recon.method.terms import Term


@dataclass(frozen=True)
class Traits:
    """What is known of a kind of prior before its weights are loaded.

    A class that differs from these has a class variable `traits`.
    """

    knows_gravity: bool = True
    """Whether it judges heights above the ground and which way is up. An unknown ground is then
    moved by its stages, and without any ground (`recon.fit(..., ground=None)`) it is refused."""
    completes: bool = False
    """Whether it is of one whole cycle of gait, for which beginnings are searched; it is then a
    `CyclePrior`."""


def traits_of(kind: object) -> Traits:
    """The traits of a prior or of its class; the usual ones where it states none."""
    return getattr(kind, "traits", Traits())


def methods_of(kind: object) -> tuple[str, ...]:
    """Names of the ways in which a prior, or one of its class, can be fitted; none for one way."""
    return tuple(getattr(kind, "methods", ()))


@runtime_checkable
class NoisyPrior(Protocol):
    """A prior that is fitted in a way that depends on how noisy the data are."""

    def method(self, noise: float, body: BodyModel) -> Method:
        """The stages for data whose coordinates are off by about `noise` metres.

        Its terms stand beside ½ |residual|² in metres² of the least noisy observation, so that a
        negative log-probability is weighted by noise².
        """
        ...


@runtime_checkable
class ManyMethods(Protocol):
    """A prior that can be fitted in more than one way."""

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the ways, the usual one first; a variable of the class."""
        ...

    def method(self, noise: float, body: BodyModel, name: str | None = None) -> Method:
        """The stages of one way, None being the usual one; see `NoisyPrior.method`."""
        ...


@runtime_checkable
class CycleMethod(Protocol):
    """How a prior of cycles is fitted, in parts between which fits are compared."""

    @property
    def prior(self) -> "CyclePrior":
        """The prior that the method is of."""
        ...

    @property
    def noise(self) -> float:
        """Metres by which coordinates of the data are off."""
        ...

    def search(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        """A quick fit that tells good beginnings from bad ones."""
        ...

    def coded(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        """Stages from a cycle that is roughly right to the best of the prior's."""
        ...

    def details(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        """Stages for what no code of the prior has; none where data are sparse."""
        ...


@runtime_checkable
class CyclePrior(Prior[Any], Protocol):
    """A prior of whole cycles of gait, each of which is one code."""

    @property
    def code_size(self) -> int:
        """Numbers in a code."""
        ...

    @property
    def typical(self) -> Float[Tensor, "typical code"]:
        """Codes of a few cycles that are unlike each other, to begin with."""
        ...

    def paths(self, shape: Float[Tensor, " shape"]) -> Float[Tensor, "typical moments 3"]:
        """The path of the pelvis in each typical cycle, at even moments, metres."""
        ...

    def variables(
        self,
        codes: Float[Tensor, "*batch code"],
        shape: Float[Tensor, "*batch shape"],
        base: Float[Tensor, "*batch 4 4"],
        valid: Bool[Tensor, "*batch time"],
        fps: float,
        start_time: float = 0.0,
    ) -> TensorStruct:
        """The cycles of these codes, placed in the world and on a clock."""
        ...

    def cycle_method(self, noise: float, *, detailed: bool) -> CycleMethod:
        """A method for data that are off by `noise` metres.

        Args:
            noise: standard deviation of every coordinate.
            detailed: whether data are dense enough to tell what no code has.
        """
        ...
