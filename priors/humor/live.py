"""HuMoR's energies of the steps between the newest frames of a live stream."""

from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from priors.humor.prior import Humor
from priors.humor.state import contact_probabilities, posed_states
from priors.humor.steps import (
    ERROR,
    SPAN,
    SURPRISE,
    CollocationWeights,
    bundled_curvature,
    heavy_tailed,
    posterior_outputs,
)
from priors.pose.prior import PoseWeights
from recon.core.motion import Motion
from recon.solver.banded import Banded, add_differences

_MEAN_HESSIAN_FACTOR = 2.0
"""Multiple of the mean Hessian. A window moves on before its steps have converged: with 0.75 hands
jump by 10 cm from frame to frame, with 3 errors are the same (validation people, lag 15)."""


@dataclass(frozen=True)
class EnergyOfSteps:
    """Energy of the steps of a window of frames under HuMoR, and the predicted contacts."""

    energy: Float[Tensor, ""]
    contacts: Float[Tensor, "time 22"]
    """Probability that a joint touches the ground."""
    error: float
    """Mean energy of the decoder's error before the robust kernel, nats per step."""
    surprise: float
    """Mean KL divergence of the latents before the robust kernel, nats per step."""


@dataclass(frozen=True, eq=False)
class LiveSteps:
    """The last stage of `Collocation` for a window that slides: the same energies and weights.

    Frames before the window are held. A step depends on frames from the one before it starts to
    the one after it ends, so as many are needed.
    """

    reach: ClassVar[int] = SPAN - 1
    humor: Humor
    weights: CollocationWeights

    @classmethod
    def for_noise(cls, humor: Humor, noise: float) -> "LiveSteps":
        """Return the energies of steps, weighted for points with `noise` metres of noise."""
        return cls(humor, CollocationWeights.for_noise(noise))

    @property
    def poses(self) -> PoseWeights:
        """Weights of the pose density and of smoothness, to use with the energy of steps."""
        return self.weights.pose

    def step_energy(
        self, motion: Motion, joints: Float[Tensor, "1 time 22 3"], held: int
    ) -> EnergyOfSteps:
        """The energy of all steps in which at least one moving frame takes part.

        Args:
            motion: of the window, at 30 Hz, a batch of one.
            joints: of the body in it, metres.
            held: frames at its beginning that do not move.
        """
        humor, weights = self.humor, self.weights
        states = posed_states(motion, joints)
        found = posterior_outputs(humor.networks, states, humor.pelvis(motion.shape))
        # no step from a held first frame: its velocity needs the frame before, which was dropped
        steps = slice(min(held, 1), None)
        error = 0.5 * (found.error[0, steps] @ humor.error_whitening).square().sum(-1)
        surprise = found.surprise[0, steps]
        contacts = contact_probabilities(found.contacts)[0]
        slip = (contacts[1:] * joints[0].diff(dim=0).square().sum(-1))[steps].sum()
        energy = (
            weights.step * heavy_tailed(error, ERROR).sum()
            + weights.latents * heavy_tailed(surprise, SURPRISE).sum()
            + 0.5 * weights.contact_velocity * slip
        )
        return EnergyOfSteps(
            energy,
            contacts.detach(),
            float(error.detach().mean()),
            float(surprise.detach().mean()),
        )

    def add_curvature(
        self,
        motion: Motion,
        evaluated: EnergyOfSteps,
        hessian: Banded,
        of_joints: Float[Tensor, "time some 66"],
    ) -> None:
        """Add the mean Hessian of steps to `hessian`, and that of feet in contact to `of_joints`.

        Args:
            motion: of the window, without a batch axis.
            evaluated: what the networks say of it.
            hessian: by the variables of all frames.
            of_joints: coefficients of `Banded.add_products` for the coordinates of joints.
        """
        weights = self.weights
        bundled_curvature(motion.translation.device).add(
            motion,
            hessian,
            _MEAN_HESSIAN_FACTOR * weights.step / (1 + evaluated.error / ERROR),
            _MEAN_HESSIAN_FACTOR * weights.latents / (1 + evaluated.surprise / SURPRISE),
        )
        held = weights.contact_velocity * evaluated.contacts[1:]
        add_differences(of_joints, (-1.0, 1.0), held.repeat_interleave(3, -1))
