"""From settings to the method of a fit: which prior, with which weights for which noise."""

from dataclasses import dataclass, replace
from typing import Any

from priors.humor import Humor
from priors.humor_collocation import Collocation
from priors.pose import PosePrior, PoseWeights
from recon.body import BodyModel
from recon.reconstruction import Method
from recon.settings import FitSettings
from recon.stages import Stage
from recon.terms import Term


def method_of(settings: FitSettings, noise: float, body: BodyModel) -> Method:
    """The method for observations whose coordinates are off by about `noise` metres.

    Raises:
        FileNotFoundError: when there are no such weights.
        ValueError: when the file of the weights holds none, or the prior has a way of its own.
    """
    match settings.prior:
        case "pose":
            prior = PosePrior.load(weights=PoseWeights.for_noise(noise))
            return prior.to(device=body.template.device)
        case "humor":
            humor = Humor.load(settings.weights, body.to(device="cpu"))
            return Collocation.for_noise(humor.like(body.template), noise)
        case "anchor":
            raise ValueError(
                "the prior anchor is of one whole cycle, for which beginnings are searched: "
                "call recon.completion.complete, or `recon complete`"
            )


_PLACE = frozenset({"translation", "root"})


@dataclass(frozen=True)
class WithoutRoot:
    """A method without its leading stages that only place the rest body.

    One image tells the distance of a body by the size of its bones. Placing a rest body there
    would trade its stretched limbs against distance.
    """

    method: Method

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """Those from the first on that moves more than place and heading."""
        stages = self.method.stages(data)
        first = next((k for k, stage in enumerate(stages) if not stage.free <= _PLACE), 0)
        return stages[first:]


@dataclass(frozen=True)
class WithScene:
    """A method that finds something of the scene as well, once there is a first motion."""

    method: Method
    moved: frozenset[str]
    """Paths such as `scene.ground.tilt`; see `recon.scene`."""
    terms: tuple[Term, ...]
    """What holds it."""

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """Its stages; the first that moves poses leaves the scene alone if others follow."""
        stages = self.method.stages(data)
        posing = [k for k, stage in enumerate(stages) if not stage.free <= _PLACE]
        return tuple(
            replace(stage, terms=(*stage.terms, *self.terms), free=stage.free | self.moved)
            if k in (posing[1:] or posing)
            else stage
            for k, stage in enumerate(stages)
        )
