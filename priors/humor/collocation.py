"""HuMoR fitted to all steps of a motion at once (direct collocation): the default method.

Single shooting moves a first state and latents and lets the decoder unroll the motion: an early
latent moves every later frame, errors of the network add up, and all steps wait for each other.
Here the motion itself is moved, in the well-scaled variables of the pose prior, and every pair of
its neighbouring states is judged by the same networks: how surprising is the latent that explains
the step, and how far from the step does the decoder land with it. Both together are the bound on
-log p(x_t | x_(t-1)) that HuMoR is trained by (section 3.2). Frames depend on their neighbours
only, so a network sees all steps of all clips as one batch.
"""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.prior import Humor
from priors.humor.state import at_tempo, contact_probabilities, posed_states, relabelled_at_30_hz
from priors.humor.steps import (
    ERROR,
    SPAN,
    SURPRISE,
    CollocationWeights,
    bundled_curvature,
    heavy_tailed,
    posterior_outputs,
)
from priors.pose.prior import PoseDensity, PosePrior, PoseVariables, PoseWeights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import KNEES
from recon.method.marquardt import preconditioned
from recon.method.priors import USUAL_NOISE, Density, Prior
from recon.method.protocols import Decoded, Estimate
from recon.method.quadratic import ClipModel
from recon.method.sensor import Sensor
from recon.method.stages import Stage
from recon.method.terms import PriorEnergy, Term, joint_acceleration, prior_energy, shape
from recon.method.timing import share_of_frames
from recon.solver.banded import add_differences
from recon.solver.lbfgs import LBFGS

_FITTED = 0.5
"""Metres²; a decrease of an objective below this is taken relative to it. It is about the
objective of errors of 2 cm of 22 joints in 60 frames."""
_LATENTS_OF_SURFACE = 0.5
"""Share of the weight of latents where only points on the body's surface are given. Chosen on
validation windows of depth, where a quarter was as good on average."""
_COMPARED = 3
"""Iterations after which motions of unseen limbs are compared. Chosen on 24 validation windows:
until convergence takes a tenth longer and leaves errors 2 % larger."""
_TRUST = 0.4
"""Share of the pose prior's weights that is a density: then 90 % of errors of hidden joints lie
within 1.645 standard deviations (validation people). A share that falls with the rarity of poses
did not make errors of people outside of the training data more likely."""
_MIN_SEEN_SHARE = 0.9
"""Share of the moments in which a joint must be seen for its clip to be seen whole."""


@dataclass(frozen=True, eq=False)
class Collocation(Prior[PoseVariables]):
    """HuMoR over motions in the variables of the pose prior, with an energy for every step.

    Fitted by stages 1 and 2 under the pose prior, then by all steps under HuMoR.
    """

    reach: ClassVar[int] = SPAN - 1
    humor: Humor
    weights: CollocationWeights = field(
        default_factory=lambda: CollocationWeights.for_noise(USUAL_NOISE)
    )
    poses: PosePrior = field(default_factory=PosePrior.load)
    """Prior of stages 1 and 2, with its weights there; its density is that of all stages."""
    tempo: float = 1.0
    """Share of its speed at which the networks read a motion (`priors.humor.likely`)."""

    @classmethod
    def for_noise(
        cls, humor: Humor, noise: float, density: PoseDensity | None = None
    ) -> "Collocation":
        """Return the prior, weighted for observations with `noise` metres per coordinate.

        Args:
            humor: whose networks judge the steps.
            noise: of the observation.
            density: of poses; None is the bundled one.
        """
        density = PosePrior.load().density if density is None else density
        poses = PosePrior(density, PoseWeights.for_noise(noise))
        poses = poses.to(device=humor.body.template.device)
        return cls(humor, CollocationWeights.for_noise(noise), poses)

    def encode(self, motion: Motion) -> PoseVariables:
        """Variables of a motion resampled to the networks' 30 Hz; exact but for the resampling.

        Raises:
            ValueError: when it has fewer than two frames.
        """
        motion = at_tempo(motion, self.tempo)
        if bool((motion.valid.sum(-1) < 2).any()):
            raise ValueError(
                "HuMoR needs steps between frames: expected at least two frames at 30 Hz, got "
                "one; take the pose prior for single frames"
            )
        return self.poses.encode(motion)

    def belief(self, noise: float) -> Density:
        """The density of the pose prior, whose smoothness approximates HuMoR's steps."""
        density = PosePrior(self.poses.density, PoseWeights.for_noise(noise)).belief(noise)
        trusted = replace(density, shape=_TRUST * density.shape)
        return replace(trusted, share=lambda m: torch.full_like(m.translation[..., 0], _TRUST))

    def from_steps(
        self, variables: PoseVariables, steps: Float[Tensor, "clips time 69"]
    ) -> PoseVariables:
        """Return the variables after a step of every frame's pose; see `PosePrior.from_steps`."""
        return self.poses.from_steps(variables, steps)

    def turns(self, variables: PoseVariables, clip: int) -> Float[Tensor, "time 63 63"]:
        """Derivatives of joint rotations by pose coordinates z; see `PosePrior.turns`."""
        return self.poses.turns(variables, clip)

    def add_curvature(self, term: Term, clip: ClipModel) -> bool:
        """Add the Gauss-Newton Hessian of one of the prior's terms; false if it has none."""
        if term.energy is contact_velocity:
            contacts = predicted_contacts(clip.estimate)[clip.clip, 1:]
            weight = term.weight * contacts.where(clip.motion.pairs[:, None], 0.0)
            add_differences(clip.joints, (-1.0, 1.0), weight.repeat_interleave(3, -1))
            return True
        energy: Any = term.energy
        if hasattr(energy, "add_curvature"):
            energy.add_curvature(term.weight, clip.estimate, clip.clip, clip.joints)
            return True
        if not isinstance(energy, PriorEnergy) or energy.name not in ("step", "latents"):
            return self.poses.add_curvature(term, clip)
        name = energy.name
        scale = ERROR if name == "step" else SURPRISE
        nats = clip.estimate.decoded.energies[name][clip.clip]
        steps = (clip.motion.valid.sum() - 1).clamp(min=1)
        # weight × the robust kernel's slope dρ/dx = exp(-ρ/scale), in geometric mean over steps
        weight = term.weight * (-nats / (scale * steps)).exp()
        error, latents = (weight, 0.0) if name == "step" else (0.0, weight)
        bundled_curvature(nats.device).add(clip.motion, clip.part, error, latents)
        return True

    def decode(self, variables: PoseVariables) -> Decoded:
        """The motion, the energies of its steps under the networks, and its contacts.

        `energies` in nats: "pose" as the pose prior's, "step" Σ ρ(½ eᵀ C⁻¹ e) of the decoder's
        errors with their covariance C over the training corpus, "latents" Σ ρ(KL);
        ρ(x) = s log(1 + x / s) has heavy tails, as a Student t has. The mixture of initial states
        is no part of the method, so it is not evaluated.
        """
        decoded = self.poses.decode(variables)
        motion, humor = decoded.motion, self.humor.like(variables.translation)
        posed = humor.body.pose(motion)
        states = posed_states(relabelled_at_30_hz(motion), posed.joints)
        pelvis = humor.pelvis(motion.shape)
        found = posterior_outputs(humor.networks, states, pelvis)
        exists = motion.valid[:, 1:]
        error = 0.5 * (found.error @ humor.error_whitening).square().sum(-1)
        energies = {
            "step": heavy_tailed(error, ERROR).where(exists, 0.0).sum(-1),
            "latents": heavy_tailed(found.surprise, SURPRISE).where(exists, 0.0).sum(-1),
        }
        return Decoded(
            motion=motion,
            energies={**decoded.energies, **energies},
            contacts=contact_probabilities(found.contacts),
            posed=posed,
        )

    def stages(
        self,
        data: tuple[Term, ...],
        noise: float = USUAL_NOISE,
        body: BodyModel | None = None,
        method: str | None = None,
    ) -> tuple[Stage[Any], ...]:
        """Three stages: root; smooth poses, roughly; likely steps, with feet held by contacts.

        Feet come last, because wrongly standing feet of a first guess would be held there. Where
        limbs are not seen for a while, there is a stage more, see `_stages_of_unseen_limbs`.

        Tolerances were chosen on the validation windows. Where all joints are seen, ten times
        smaller ones take longer and leave the errors as they are. Limbs that are hidden for a
        while need smaller ones, unless only images are fitted. So do clouds, in which limbs may be
        hidden without being marked so.
        """
        del noise, body, method  # unused: the constructor got weights for the sensors' noise
        w = self.weights
        surface = all(getattr(term.energy, "sees", None) == "surface" for term in data)
        latents = w.latents * (_LATENTS_OF_SURFACE if surface else 1.0)
        terms = (
            *data,
            Term("pose", prior_energy("pose"), w.pose.pose),
            Term("shape", shape, w.pose.shape),
            Term("acceleration", joint_acceleration, w.pose.acceleration),
            Term("step", prior_energy("step"), w.step),
            Term("latents", prior_energy("latents"), latents),
        )
        free = frozenset({"translation", "root", "pose", "shape"})
        root, poses = self.poses.stages(data)
        in_images = all(getattr(term.energy, "unit", "pixels") == "pixels" for term in data)
        early, late = (2e-2, 3e-4) if in_images else (2e-3, 3e-5)
        held = Term("contact velocity", contact_velocity, w.contact_velocity)
        last = LBFGS(max_iterations=400, tolerance_decrease=late, scale=_FITTED, history=40)
        feet = Stage("contacts", self, (*terms, held), free, last, second_order=preconditioned)
        if not all_joints_located(data, self.humor.body):
            compared = LBFGS(max_iterations=_COMPARED, tolerance_decrease=early)
            limbs = Stage("limbs", self, terms, free, compared, kept=1)
            if found := self._stages_of_unseen_limbs(data, limbs, feet):
                smooth = replace(poses.minimiser, tolerance_decrease=1e-3)
                return root, replace(poses, minimiser=smooth), *found
        rough = replace(poses.minimiser, tolerance_decrease=1e-2)
        ended = replace(last, tolerance_decrease=late if surface else 3e-4)
        return root, replace(poses, minimiser=rough), replace(feet, minimiser=ended)

    def _stages_of_unseen_limbs(
        self, data: tuple[Term, ...], limbs: Stage[Any], feet: Stage[Any]
    ) -> tuple[Stage[Any], ...]:
        """Return the last stages where limbs are not seen for a while; none where all are seen.

        `limbs` begins from two proposed motions of them, and the one of the lower objective goes
        on to `feet`. Where limbs are never seen, states must be likely, too, gravity asks for a
        foot that carries the body, and motions faster than the networks know are read slower.
        There, smaller tolerances make the errors of legs larger: the networks alone decide, and
        their optimum is not the truth.
        """
        # imported only when some joints may be hidden for a while
        from priors.look.looking import UnseenLimbProposals, UnseenLimbs, load_network

        unseen = UnseenLimbs.of(data, self.humor.body)
        if unseen is None:
            return ()
        network = load_network(device=self.humor.body.template.device)
        limbs = replace(limbs, proposals=UnseenLimbProposals(network, unseen))
        if not bool(unseen.never.any()):
            return limbs, feet
        # imported only when limbs are never seen
        from priors.humor.likely import LikelyStates, slowing_factor
        from recon.physics.support import SupportEnergy

        w = self.weights
        carried = Term("support", SupportEnergy(unseen.never[:, KNEES].any(-1)), w.support)
        likely = Term("state", LikelyStates(self.humor, unseen.never), w.state)
        read = replace(self, tempo=slowing_factor(data))
        all_terms = (*feet.terms, carried, likely)
        limbs = replace(limbs, prior=read, terms=all_terms, second_order=preconditioned)
        ended = replace(feet.minimiser, tolerance_decrease=1e-4)
        return limbs, replace(feet, prior=read, terms=all_terms, minimiser=ended)


def all_joints_located(data: tuple[Term, ...], body: BodyModel) -> bool:
    """Whether one sensor locates every joint in space in most frames of every clip."""
    return any(
        isinstance(term.energy, Sensor)
        and term.energy.unit == "metres"
        and (located := term.energy.joints_located(body)) is not None
        and bool((share_of_frames(located) >= _MIN_SEEN_SHARE).all())
        for term in data
    )


def contact_velocity(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ c |p_t - p_(t-1)|² of the body's joints, c their probability of contact; metres²."""
    step = estimate.body.joints.diff(dim=-3).square().sum(-1)
    moved = (predicted_contacts(estimate)[..., 1:, :] * step).sum(-1)
    return 0.5 * moved.where(estimate.motion.pairs, 0.0).sum(-1)


def predicted_contacts(estimate: Estimate) -> Float[Tensor, "*batch time 22"]:
    """Return the probability of contact that the prior predicts for every joint, 0 to 1.

    Raises:
        ValueError: when the prior predicts none.
    """
    if estimate.decoded.contacts is None:
        raise ValueError("expected a prior that predicts contacts, such as Humor")
    return estimate.decoded.contacts
