"""A fit of the HUMOS prior by its codes: poses first, then codes, then details with the ground.

Slower to converge than `priors.humos.collocation`, the default: codes are whitened by how motions
vary, from metres to millimetres, and data want all of them alike.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from priors.humos.prior import Humos, HumosVariables
from priors.pose.prior import PosePrior, PoseWeights
from recon.core.motion import Motion
from recon.method.protocols import Decoded
from recon.method.stages import Stage
from recon.method.terms import Term, joint_acceleration, prior_energy
from recon.physics import energies as physics
from recon.solver.lbfgs import LBFGS

_CODES = frozenset({"latent", "turn", "place", "shape"})
_DETAILS = _CODES | {"bend", "shift"}


@dataclass(frozen=True, eq=False)
class HumosCodes:
    """The prior where a first guess is noisy: it gives codes, and no details."""

    humos: Humos

    def encode(self, motion: Motion) -> HumosVariables:
        """Mean codes of a motion."""
        found = self.humos.encode(motion)
        return found.replace(bend=0 * found.bend, shift=0 * found.shift)

    def decode(self, variables: HumosVariables) -> Decoded:
        """The motion of the variables and its energies; see `Humos.decode`."""
        return self.humos.decode(variables)


@dataclass(frozen=True)
class CodesWeights:
    """Multipliers of the unweighted energies, for an observation of weight one."""

    latent: float
    """Weight of the density of codes that follow each other, nats."""
    details: float
    """Weight of the density of details, nats."""
    shape: float
    """Weight of the density of the body's shape, nats."""
    acceleration: float
    """Weight of ½ Σ |second difference|² of joints, metres²."""
    ground: float
    """Weight of penetration and slide, metres²."""

    @classmethod
    def for_noise(cls, noise: float) -> "CodesWeights":
        """Weights for observations of a standard deviation of about `noise` metres.

        A negative log-probability counts noise² for each nat.
        """
        variance = max(noise, 0.01) ** 2
        return cls(
            latent=variance, details=variance, shape=variance,
            acceleration=PoseWeights.for_noise(noise).acceleration, ground=1.0,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class CodesFit:
    """A method: stages 1 and 2 under the pose prior, then codes, then all variables."""

    humos: Humos
    weights: CodesWeights
    start: PoseWeights = field(default_factory=PoseWeights.tuned_joints)
    """Weights of stages 1 and 2."""

    @classmethod
    def for_noise(cls, humos: Humos, noise: float) -> "CodesFit":
        """A fit of observations of a standard deviation of about `noise` metres."""
        return cls(humos, CodesWeights.for_noise(noise), PoseWeights.for_noise(noise))

    @cached_property
    def _poses(self) -> PosePrior:
        return PosePrior.load(weights=self.start).to(device=self.humos.body.template.device)

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """Root; poses, smoothly; codes; codes and details on the ground."""
        w, prior = self.weights, HumosCodes(self.humos)
        terms = (
            *data,
            Term("latent", prior_energy("latent"), w.latent),
            Term("shape", prior_energy("shape"), w.shape),
            Term("acceleration", joint_acceleration, w.acceleration),
        )
        held = (
            Term("details", prior_energy("details"), w.details),
            Term("penetration", physics.penetration, w.ground),
            Term("slide", physics.slide, w.ground),
        )
        minimiser = LBFGS(max_iterations=60, tolerance_decrease=1e-5)
        return (
            *self._poses.stages(data),
            Stage("codes", prior, terms, _CODES, minimiser),
            Stage("details", prior, (*terms, *held), _DETAILS, minimiser),
        )
