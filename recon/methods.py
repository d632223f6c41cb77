"""From settings to the method of a fit: which prior, with which weights for which noise."""

from priors.humor import Humor
from priors.humor_collocation import Collocation
from priors.pose import PosePrior, PoseWeights
from recon.body import BodyModel
from recon.reconstruction import Method
from recon.settings import FitSettings


def method_of(settings: FitSettings, noise: float, body: BodyModel) -> Method:
    """The method for observations whose coordinates are off by about `noise` metres.

    Raises:
        FileNotFoundError: when there are no such weights.
        ValueError: when the file of the weights holds none.
    """
    match settings.prior:
        case "pose":
            prior = PosePrior.load(weights=PoseWeights.for_noise(noise))
            return prior.to(device=body.template.device)
        case "humor":
            humor = Humor.load(settings.weights, body.to(device="cpu"))
            return Collocation.for_noise(humor.like(body.template), noise)
