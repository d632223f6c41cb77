"""Prior knowledge of a person's shape, as energy terms."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.method.priors import MODEL_NOISE
from recon.method.protocols import REFERENCE_FPS, Energy, Estimate
from recon.method.terms import Term


@dataclass(frozen=True)
class ShapePrior:
    """A normal density over body shapes: of the height, of the coefficients, or of both.

    It is weighted once per frame at 30 Hz, as the shape density of every fit is, because errors
    of sensors and models about sizes are the same in every frame.
    """

    mean: Float[Tensor, " shape"]
    """The likeliest coefficients, which fits begin with."""
    height: float | None
    """Metres from the soles to the crown; None leaves it open."""
    height_std: float
    """Standard deviation of the height, metres."""
    std: float | None
    """Standard deviation of every coefficient about `mean`; None leaves them open."""

    def terms(self, body: BodyModel, noise: float) -> tuple[Term, ...]:
        """Return the density's terms, weighted for observations with `noise` metres of noise."""
        weight = max(noise, MODEL_NOISE) ** 2
        found: list[Term] = []
        if self.height is not None:
            energy = _height_energy(body, self.mean, self.height, self.height_std)
            found.append(Term("height", energy, weight))
        if self.std is not None:
            energy = _coefficient_energy(self.mean.to(body.template), self.std)
            found.append(Term("known shape", energy, weight))
        return tuple(found)


def _height_energy(
    body: BodyModel, mean: Float[Tensor, " shape"], metres: float, std: float
) -> Energy:
    """Return the energy ½ ((h(s) - h) / std)² per frame, h(s) being the height of shape s.

    h(s) = h(s0) + g·(s - s0), with the gradient g at the likeliest shape s0.
    """
    exact = body.to(device="cpu", dtype=torch.float64)
    likeliest = mean.detach().cpu().double().requires_grad_()
    with torch.enable_grad():
        height = exact.height(likeliest)
        (slope,) = torch.autograd.grad(height, likeliest)
    error_at_zero = float(height.detach()) - float(slope @ likeliest.detach()) - metres
    slope = slope.to(body.template)

    def energy(estimate: Estimate) -> Float[Tensor, "*batch"]:
        shape = estimate.motion.shape
        return 0.5 * ((shape @ slope + error_at_zero) / std).square() * _frames_at_30_hz(estimate)

    return energy


def _coefficient_energy(mean: Float[Tensor, " shape"], std: float) -> Energy:
    """Return the energy ½ |s - mean|² / std² per frame of the shape coefficients s."""

    def energy(estimate: Estimate) -> Float[Tensor, "*batch"]:
        shape = estimate.motion.shape
        return 0.5 * ((shape - mean) / std).square().sum(-1) * _frames_at_30_hz(estimate)

    return energy


def _frames_at_30_hz(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return the number of frames that each clip would have at 30 Hz."""
    motion = estimate.motion
    return motion.valid.sum(-1).to(motion.shape) * (REFERENCE_FPS / motion.fps)
