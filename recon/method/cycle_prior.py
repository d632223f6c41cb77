"""The base class of priors that encode a whole cycle of gait as one latent code."""

from abc import abstractmethod
from typing import Any, ClassVar

from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.struct import S
from recon.method.priors import USUAL_NOISE, Prior
from recon.method.stages import Stage
from recon.method.terms import Term


class CyclePrior(Prior[S]):
    """A prior of whole cycles of gait, one latent code each, fitted from many first guesses."""

    completes: ClassVar[bool] = True

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """Return stages that refine a roughly correct cycle: its latent code, then details."""
        del body, method
        return (*self.coded(data, noise), *self.details(data, noise))

    @property
    @abstractmethod
    def code_size(self) -> int:
        """Dimension of a latent code."""

    @property
    @abstractmethod
    def typical(self) -> Float[Tensor, "typical code"]:
        """Latent codes of a few different gait cycles, from which fits begin."""

    @abstractmethod
    def paths(self, shape: Float[Tensor, " shape"]) -> Float[Tensor, "typical moments 3"]:
        """Return the pelvis path of each typical cycle, at evenly spaced times, metres."""

    @abstractmethod
    def variables(
        self,
        codes: Float[Tensor, "*batch code"],
        shape: Float[Tensor, "*batch shape"],
        base: Float[Tensor, "*batch 4 4"],
        valid: Bool[Tensor, "*batch time"],
        fps: float,
        start_time: float = 0.0,
    ) -> S:
        """Return variables for the cycles of latent codes, each with its pose in the world."""

    @abstractmethod
    def search(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Return the stages of a quick fit by which first guesses are compared."""

    @abstractmethod
    def coded(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Return stages that find the best latent code from a roughly correct cycle."""

    @abstractmethod
    def details(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Return stages that add corrections which no latent code can express (dense data)."""
