"""HuMoR's roll-out fitted to data: a first state and latents are optimised (single shooting)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.collocation import Collocation, contact_velocity, predicted_contacts
from priors.humor.prior import Humor
from priors.humor.unrolled import HumorVariables
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS
from recon.method.priors import USUAL_NOISE, Prior
from recon.method.protocols import Decoded, Energy, Estimate
from recon.method.stages import Stage
from recon.method.terms import Term, ground_moved, prior_energy, shape
from recon.solver.lbfgs import LBFGS

FIRST_FRAMES = 15
"""Number of frames of the phase that finds the first state, as published."""
_LEAST_NOISE = 0.014
"""Metres; nobody moves just like the people of the corpus, however exact points are."""
_NUMBERS = 60 * 22 * 3
"""Coordinates of joints in a usual clip; noise alone is an energy of half their number."""

_STATE = frozenset(
    {"translation", "root", "pose", "velocity", "angular_velocity", "joint_velocities"}
)
_REST = frozenset({"latents", "shape"})


@dataclass(frozen=True)
class HumorWeights:
    """Weights by which the prior's energies are multiplied, for observations of weight one."""

    transition: float
    """Weight of -log p of the latents, in nats."""
    initial: float
    """Weight of -log p of the first state, in nats, for every 15 frames."""
    shape: float = 1.67e-4
    consistency: float = 1.0
    bones: float = 10.0
    contact_velocity: float = 1.0
    contact_height: float = 1.0
    ground: float = 0.0
    """Weight of ½ (turn² + lift²) of an unknown ground away from where it began, radians² and
    metres², for every frame."""

    @classmethod
    def for_noise(cls, noise: float) -> "HumorWeights":
        """Weights for observations of a standard deviation of `noise` metres per coordinate."""
        variance = max(noise, _LEAST_NOISE) ** 2
        return cls(transition=0.2 * variance, initial=0.02 * variance, shape=5e-6)


_IMAGES = HumorWeights(
    transition=0.075, initial=0.075, shape=0.05, consistency=100.0, bones=2000.0,
    contact_velocity=100.0, contact_height=10.0, ground=0.167,
)  # fmt: skip
PUBLISHED: Mapping[str, tuple[HumorWeights, PoseWeights]] = MappingProxyType(
    {
        "joints": (HumorWeights(1e-3, 1e-3), PoseWeights(2e-4, 1.67e-4, velocity=10.0)),
        "points": (HumorWeights(5e-4, 5e-4), PoseWeights(2e-4, 1.67e-4, velocity=0.1)),
        "images": (_IMAGES, PoseWeights(0.04, 0.05, velocity=100.0)),
        "depth": (
            replace(_IMAGES, shape=0.034, ground=1.0),
            PoseWeights(0.1, 0.034, velocity=100.0),
        ),
    }
)
"""Published weights of stage 3 and of stages 1 and 2: for joints with noise of 4 cm
(fit_amass_joints.cfg), surface points, some of them hidden (fit_amass_keypts.cfg), keypoints of
one camera, of weight 0.002 (fit_rgb_demo_*.cfg), and these with depth (fit_proxd.cfg)."""


@dataclass(frozen=True)
class IterationSchedule:
    """Iteration limits of the phases; a phase with a limit of zero is skipped."""

    first: int = 0
    """Phase of the first 15 frames, in which first state and latents move."""
    latents: int = 0
    """Phase of all latents, in which the first state is held."""
    all: int = 1000
    """Phase in which everything moves."""
    tolerance: float = 3e-5
    """Relative decrease of the objective at which a phase ends, thrice in a row."""
    scale: float = 0.0
    """Objective below which its decrease is taken relative to this, in the unit of the data."""
    history: int = 100
    """Steps from which the minimiser learns how the objective bends."""

    @classmethod
    def published(cls) -> "IterationSchedule":
        """The published numbers of iterations (600, 500, 300), without a test of convergence."""
        return cls(600, 500, 300, tolerance=1e-9)


_AS_PUBLISHED = MappingProxyType({"metres": 1.0, "pixels": 0.002})


@dataclass(frozen=True, eq=False)
class Shooting(Prior[HumorVariables]):
    """HuMoR by single shooting: the first state and the latents are optimised.

    The shape is moved with them, and so is the ground where it is not known. The first state has
    the mixture for an energy and the latents the conditional prior. The usual start is the motion
    that `Collocation` finds; the presets have the phases, weights and start of the publication
    (section 6.8).
    """

    level: ClassVar[bool] = True
    humor: Humor
    weights: HumorWeights = PUBLISHED["joints"][0]
    schedule: IterationSchedule = field(default_factory=IterationSchedule)
    start: Prior[Any] = field(default_factory=PosePrior.load)
    """Finds the motion from which first state and latents are encoded."""
    data_weights: Mapping[str, float] | None = None
    """Weights of observations by their unit, instead of those of the fit."""

    @classmethod
    def for_noise(cls, humor: Humor, noise: float) -> "Shooting":
        """The method for observations of a standard deviation of `noise` metres per coordinate."""
        variance = max(noise, _LEAST_NOISE) ** 2
        return cls(
            humor,
            HumorWeights.for_noise(noise),
            IterationSchedule(scale=0.5 * _NUMBERS * variance),
            start=Collocation.for_noise(humor, noise),
        )

    @classmethod
    def published(cls, humor: Humor, sensor: str) -> "Shooting":
        """Return the method with the published settings for a sensor, a key of `PUBLISHED`."""
        weights, poses = PUBLISHED[sensor]
        start = PosePrior.load(weights=poses).to(device=humor.body.template.device)
        return cls(humor, weights, IterationSchedule.published(), start, _AS_PUBLISHED)

    def encode(self, motion: Motion) -> HumorVariables:
        """Encode a motion as first state and latents; see `Humor.encode`."""
        return self.humor.encode(motion)

    def decode(self, variables: HumorVariables) -> Decoded:
        """Decode first state and latents to a motion; see `Humor.decode`."""
        return self.humor.decode(variables)

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """Return the stages: start, first 15 frames, latents alone, all variables.

        Contacts count in the first and the last phase. Phases without iterations are left out.
        """
        del noise, body, method  # unused: the constructor got weights for the sensors' noise
        if self.data_weights is not None:
            data = tuple(_with_sensor_weight(term, self.data_weights) for term in data)
        return (*self.start.stages(data), *self._phases(data))

    def _phases(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        w, schedule = self.weights, self.schedule
        ground = (Term("ground held", _summed_ground_energy, w.ground),) if w.ground > 0 else ()
        always = (
            *data,
            Term("transition", prior_energy("transition"), w.transition),
            Term("initial", _scaled_by_clip_length(prior_energy("initial")), w.initial),
            Term("shape", shape, w.shape),
            Term("consistency", joint_consistency, w.consistency),
            Term("bones", bone_length, w.bones),
            *ground,
        )
        contacts = (
            Term("contact velocity", contact_velocity, w.contact_velocity),
            Term("contact height", contact_height, w.contact_height),
        )

        def stage(
            name: str,
            terms: tuple[Term, ...],
            free: frozenset[str],
            iterations: int,
            portion: Callable[[HumorVariables], HumorVariables] | None = None,
        ) -> tuple[Stage[Any], ...]:
            minimiser = LBFGS(
                max_iterations=iterations,
                history=schedule.history,
                tolerance_decrease=schedule.tolerance,
                scale=schedule.scale,
            )
            found: Stage[Any] = Stage(name, self.humor, terms, free, minimiser, portion)
            return (found,) if iterations > 0 else ()

        return (
            *stage(
                "first state", (*always, *contacts), _STATE | _REST, schedule.first,
                lambda variables: variables.first_frames(FIRST_FRAMES),
            ),
            *stage("latents", always, _REST, schedule.latents),
            *stage("all", (*always, *contacts), _STATE | _REST, schedule.all),
        )  # fmt: skip


def _with_sensor_weight(term: Term, weights: Mapping[str, float]) -> Term:
    """The term with the weight of its sensor's unit; terms of no sensor are unchanged."""
    unit: str = getattr(term.energy, "unit", "")
    return term if unit not in weights else replace(term, weight=weights[unit])


def _summed_ground_energy(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """The energy `ground_moved`, counted once per frame; zero where the ground is known."""
    frames = estimate.motion.valid.sum(-1)
    if estimate.scene.ground is None:
        return torch.zeros_like(estimate.motion.shape[..., 0])
    return ground_moved(estimate) * frames


def _scaled_by_clip_length(energy: Energy) -> Callable[[Estimate], Float[Tensor, "*batch"]]:
    """Multiply an energy by the number of frames / 15, as the published second phase does."""
    return lambda estimate: energy(estimate) * (estimate.motion.valid.sum(-1) / FIRST_FRAMES)


_TOUCHING = 0.08
"""Metres a joint in contact may be above or below the ground (published)."""


def joint_consistency(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ |p - p̂|² between the body's joints p and the predicted joints p̂; metres²."""
    away = estimate.body.joints - _predicted_joints(estimate)
    squared = away.square().sum((-1, -2))
    return 0.5 * squared.where(estimate.motion.valid, 0.0).sum(-1)


def bone_length(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ (l_t - l_(t-1))² of the bone lengths of the predicted joints; metres²."""
    joints = _predicted_joints(estimate)
    lengths = (joints[..., 1:, :] - joints[..., PARENTS[1:], :]).norm(dim=-1)
    change = lengths.diff(dim=-2).square().sum(-1)
    return 0.5 * change.where(estimate.motion.pairs, 0.0).sum(-1)


def contact_height(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Σ c max(|z| - 8 cm, 0) of the body's joints above the ground z = 0; metres."""
    away = (estimate.body.joints[..., 2].abs() - _TOUCHING).relu()
    height = (predicted_contacts(estimate) * away).sum(-1)
    return height.where(estimate.motion.valid, 0.0).sum(-1)


def _predicted_joints(estimate: Estimate) -> Float[Tensor, "*batch time 22 3"]:
    if estimate.decoded.joints is None:
        raise ValueError("expected a prior that predicts joints beside the pose, such as Humor")
    return estimate.decoded.joints
