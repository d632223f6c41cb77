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
        """Stages that refine a cycle of gait which is roughly right."""
        del body, method
        return (*self.coded(data, noise), *self.details(data, noise))

    @property
    @abstractmethod
    def code_size(self) -> int:
        """Dimension of a latent code."""

    @property
    @abstractmethod
    def typical(self) -> Float[Tensor, "typical code"]:
        """Latent codes of a few different cycles, as first hypotheses."""

    @abstractmethod
    def paths(self, shape: Float[Tensor, " shape"]) -> Float[Tensor, "typical moments 3"]:
        """The path of the pelvis in each typical cycle, at evenly spaced moments, metres."""

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
        """The cycles of these codes, placed in the world and on a clock."""

    @abstractmethod
    def search(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Stages of a quick fit that ranks first hypotheses."""

    @abstractmethod
    def coded(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Stages that find the best latent code, starting from a cycle that is roughly right."""

    @abstractmethod
    def details(self, data: tuple[Term, ...], noise: float) -> tuple[Stage[Any], ...]:
        """Stages for corrections that no latent code can express, for dense data."""
