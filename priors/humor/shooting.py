"""HuMoR's published fit, single shooting: a first state and latents, in three phases."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float
from torch import Tensor

from priors.humor.prior import Humor
from priors.humor.terms import (
    bone_length,
    contact_height,
    contact_velocity,
    joint_consistency,
)
from priors.pose.prior import PosePrior, PoseWeights
from recon.method.protocols import Energy, Estimate
from recon.method.stages import Stage
from recon.method.terms import Term, prior_energy, shape
from recon.solver.lbfgs import LBFGS

FIRST_FRAMES = 15
"""Number of frames of the phase that finds the first state, as published."""

_STATE = frozenset(
    {"translation", "root", "pose", "velocity", "angular_velocity", "joint_velocities"}
)
_REST = frozenset({"latents", "shape"})


@dataclass(frozen=True)
class HumorWeights:
    """Multipliers of the unweighted energies, for an observation of weight one (section 6.9)."""

    transition: float
    """Weight of -log p of the latents, in nats."""
    initial: float
    """Weight of -log p of the first state, in nats, for every 15 frames."""
    shape: float = 1.67e-4
    consistency: float = 1.0
    bones: float = 10.0
    contact_velocity: float = 1.0
    contact_height: float = 1.0

    @classmethod
    def published_joints(cls) -> "HumorWeights":
        """Published for joints with noise of 4 cm (fit_amass_joints.cfg, stage 3)."""
        return cls(transition=1e-3, initial=1e-3)

    @classmethod
    def published_points(cls) -> "HumorWeights":
        """Published for surface points, some hidden (fit_amass_keypts.cfg, stage 3)."""
        return cls(transition=5e-4, initial=5e-4)


@dataclass(frozen=True)
class Schedule:
    """Largest numbers of iterations of the three phases; 600, 500 and 300 were published."""

    first: int = 150
    latents: int = 120
    all: int = 200
    tolerance: float = 1e-5


@dataclass(frozen=True, eq=False)
class Shooting:
    """Stages 1 and 2 under the pose prior, then HuMoR's three phases (section 6.8).

    The optimised variables are a first state, the latents and the shape. The decoder computes the
    motion from them.
    """

    prior: Humor
    weights: HumorWeights = field(default_factory=HumorWeights.published_joints)
    schedule: Schedule = field(default_factory=Schedule)
    poses: PoseWeights = field(default_factory=PoseWeights.tuned_joints)
    """Weights of stages 1 and 2."""

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        """The root, the poses, the first 15 frames, all latents (first state fixed), and then all.

        Contacts count in the first and the last phase.
        """
        start = PosePrior.load(weights=self.poses).to(device=self.prior.body.template.device)
        return (*start.stages(data), *_phases(self.prior, self.weights, self.schedule, data))


def _phases(
    prior: Humor, weights: HumorWeights, schedule: Schedule, data: tuple[Term, ...]
) -> tuple[Stage[Any], ...]:
    w = weights
    always = (
        *data,
        Term("transition", prior_energy("transition"), w.transition),
        Term("initial", _per_first_frames(prior_energy("initial")), w.initial),
        Term("shape", shape, w.shape),
        Term("consistency", joint_consistency, w.consistency),
        Term("bones", bone_length, w.bones),
    )
    contacts = (
        Term("contact velocity", contact_velocity, w.contact_velocity),
        Term("contact height", contact_height, w.contact_height),
    )

    def least(iterations: int) -> LBFGS:
        return LBFGS(max_iterations=iterations, tolerance_decrease=schedule.tolerance)

    return (
        Stage(
            "first state", prior, (*always, *contacts), _STATE | _REST, least(schedule.first),
            frames=FIRST_FRAMES,
        ),
        Stage("latents", prior, always, _REST, least(schedule.latents)),
        Stage("all", prior, (*always, *contacts), _STATE | _REST, least(schedule.all)),
    )  # fmt: skip


def _per_first_frames(energy: Energy) -> Callable[[Estimate], Float[Tensor, "*batch"]]:
    """One count for every 15 frames, as the published scale does from the second phase on."""
    return lambda estimate: energy(estimate) * (estimate.motion.valid.sum(-1) / FIRST_FRAMES)
