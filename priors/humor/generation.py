"""New motions from HuMoR: latents drawn from the conditional prior, step after step."""

from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.prior import Humor
from priors.humor.state import (
    Frame,
    State,
    canonical_state,
    contact_probabilities,
    independent_features,
    initial_features,
    posed_joints,
    state_after_step,
    states_of,
)
from priors.humor.steps import RARITY, heavy_tailed
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.contacts import heights_in_contact, rest_heights
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.skeleton import FEET, JOINTS
from recon.core.struct import TensorStruct, stack
from recon.method.protocols import REFERENCE_FPS, Decoded, Estimate
from recon.method.running import run_stages
from recon.method.terms import Term
from recon.physics.support import carried_share, foot_energy

_SUNK = 0.01
"""Metres below its height at rest that a joint of a foot may be."""
_SUNK_SCALE = 0.02
"""Standard deviation of what is deeper, metres."""
_ABOVE = 0.02
"""Metres that the lower foot of a body that does not fly may be above the ground."""


@dataclass(frozen=True)
class FootingSettings:
    """Settings that keep sampled motions on the ground; chosen on validation people."""

    draws: int = 8
    """Candidates that are drawn for each next state, of which one is kept."""
    strictness: float = 4.0
    """A draw is kept with probability ∝ exp(-strictness · nats)."""
    rarity: float = 0.2
    """Weight of a draw's rarity (`Mixture.rarity`, nats) beside the nats of its feet.

    States become rare before a body falls. Larger weights keep more bodies on their feet, but
    these move less."""
    raised: float = 0.2
    """Share of the depth of a sunk foot by which the body is raised in every step."""
    lowered: float = 0.1
    """Share of the height of the lower foot by which a body that does not fly is lowered."""

    def selected_draws(
        self,
        before: State,
        after: State,
        contact_heights: Float[Tensor, "all 4"],
        rarity: Float[Tensor, " all"],
        random: torch.Generator,
    ) -> Int[Tensor, " clips"]:
        """Select one sample of each group of `draws`, usual states on the ground likelier.

        Args:
            before: states in the world, each repeated for its draws.
            after: the draws.
            contact_heights: heights at which ankles and toes touch, metres.
            rarity: of the draws, nats.
            random: of the choice.
        """
        height = after.joints[:, FEET, 2] - contact_heights
        speed = (after.joints - before.joints)[:, FEET].square().sum(-1) * REFERENCE_FPS**2
        foot_nats = foot_energy(height, speed).amin(-1)
        sunk = (-height - _SUNK).amax(-1).clamp(min=0) / _SUNK_SCALE
        ground_nats = _share_carried(before, after) * foot_nats + 0.5 * sunk.square()
        nats = ground_nats + self.rarity * rarity
        likely = (-self.strictness * nats).unflatten(0, (-1, self.draws)).softmax(-1)
        chosen = torch.multinomial(likely.cpu(), 1, generator=random)[:, 0].to(
            contact_heights.device
        )
        return chosen + self.draws * torch.arange(len(chosen), device=chosen.device)

    def moved_towards_ground(
        self, before: State, after: State, contact_heights: Float[Tensor, "clips 4"]
    ) -> State:
        """Return states moved vertically so that the lowest foot comes nearer to the ground."""
        height = (after.joints[:, FEET, 2] - contact_heights).amin(-1)
        raised = self.raised * (-height - _SUNK).clamp(min=0)
        lowered = self.lowered * _share_carried(before, after) * (height - _ABOVE).clamp(min=0)
        up = after.translation.new_tensor([0.0, 0.0, 1.0])
        shift = (raised - lowered)[:, None] * up
        return after.replace(
            translation=after.translation + shift, joints=after.joints + shift[:, None]
        )


def _share_carried(before: State, after: State) -> Float[Tensor, " all"]:
    """Share of the body's weight that the ground carries, from the pelvis' acceleration."""
    rise = (after.joints - before.joints)[:, 0, 2] * REFERENCE_FPS
    return carried_share((rise - before.velocity[:, 2]) * REFERENCE_FPS)


def drawn_step(
    networks: HumorNetworks,
    state: State,
    pelvis: Float[Tensor, "clips 3"],
    random: torch.Generator | None,
    *,
    temperature: float = 1.0,
) -> tuple[Frame, State, Float[Tensor, "clips 9"]]:
    """Make one step of a motion, with a latent drawn from the prior or with its mean.

    Args:
        networks: in the states' precision and on their device.
        state: in the world.
        pelvis: of the bodies at rest, horizontally.
        random: of the latents; None takes the mean.
        temperature: factor on the prior's standard deviations.

    Returns:
        The canonical frame of the state, the next state in it, and the logits of contacts.
    """
    frame = Frame.of(state)
    canonical = frame.to_frame(state, pelvis)
    packed = canonical.pack()
    latent, log_variance = networks.prior(packed)
    if random is not None:
        noise = torch.randn(latent.shape, generator=random).to(latent)
        latent = latent + temperature * noise * (0.5 * log_variance).exp()
    return frame, *state_after_step(canonical, networks.decode(packed, latent))


TEMPERATURE = 0.9
"""Factor on the standard deviations of the prior for motions that are made up: with all of the
spread, errors of steps add up to motions that leave their feet more often."""
_FOOTING = FootingSettings()


def body_at_joints(state: State, rest: Float[Tensor, "clips 22 3"]) -> State:
    """Move the body to the mean of the predicted joints, and replace these by the body's joints.

    The network knows best by its joints how high a body is.
    """
    joints = posed_joints(state, rest)
    shift = (state.joints - joints).mean(-2)
    return state.replace(
        translation=state.translation + shift, joints=joints + shift[..., None, :]
    )


@torch.no_grad()
def roll_out_from(
    humor: Humor,
    first: State,
    shape: Float[Tensor, "clips shape"],
    frames: int,
    random: torch.Generator | None,
    *,
    temperature: float = 1.0,
    footing: FootingSettings | None = _FOOTING,
    start_time: float = 0.0,
) -> Decoded:
    """Return motions (clips, frames) at 30 Hz that continue given states by random steps.

    Args:
        humor: in the states' precision and on their device.
        first: in the world, axis (clips).
        shape: of the bodies.
        frames: the first included.
        random: of the latents; None takes the prior's mean at every step.
        temperature: factor on the prior's standard deviations; above 1 draws more varied motions.
        footing: how the ground holds the bodies; None leaves it to the networks.
        start_time: of the first frame, seconds.

    Raises:
        ValueError: when fewer than two frames are asked for.
    """
    if frames < 2:
        raise ReconError(
            f"a motion from HuMoR has at least two frames, got frames={frames}; ask for more"
        )
    touching = heights_in_contact(rest_heights(humor.body, shape))[:, FEET]
    draws = 1 if footing is None or random is None else footing.draws
    bodies = humor.pelvis(shape), humor.body.rest_joints(shape), touching
    pelvis, rest, low = (_repeated_rows(tensor, draws) for tensor in bodies)
    states, logits = [first], []
    for _ in range(frames - 1):
        before = states[-1].map(partial(_repeated_rows, count=draws))
        frame, reached, touched = drawn_step(
            humor.networks, before, pelvis, random, temperature=temperature
        )
        after = frame.from_frame(body_at_joints(reached, rest), pelvis)
        if footing is not None:
            if draws > 1:
                assert random is not None
                features = initial_features(canonical_state(after, pelvis))
                rarity = heavy_tailed(humor.initial.rarity(features), RARITY)
                selected = footing.selected_draws(before, after, low, rarity, random)
                after, touched = after[selected], touched[selected]
            after = footing.moved_towards_ground(states[-1], after, touching)
        states.append(after)
        logits.append(touched)

    found = stack(states).map(lambda tensor: tensor.transpose(0, 1))
    contacts = contact_probabilities(torch.stack(logits, 1))
    motion = Motion.create(
        translation=found.translation,
        rotations=found.rotations,
        shape=shape,
        fps=REFERENCE_FPS,
        start_time=start_time,
    )
    return Decoded(motion, contacts=contacts, joints=found.joints)


def _repeated_rows(tensor: Tensor, count: int) -> Tensor:
    return tensor.repeat_interleave(count, 0)


@torch.no_grad()
def predict(
    humor: Humor,
    motion: Motion,
    frames: int,
    samples: int,
    random: torch.Generator | None,
    *,
    temperature: float = TEMPERATURE,
    footing: FootingSettings | None = _FOOTING,
) -> Decoded:
    """Return random continuations (samples · clips, frames) of motions at 30 Hz.

    The first frame is the motion's last. All clips of the first sample come first.

    Args:
        humor: the prior.
        motion: axes (clips, time) at any rate; its last two frames tell where to start and how
            fast.
        frames: to come, the first included.
        samples: continuations of every clip.
        random: of the latents; None takes the prior's mean at every step.
        temperature: as of `roll_out_from`.
        footing: as of `roll_out_from`.

    Raises:
        ValueError: when a clip is padded or shorter than two frames.
    """
    if not bool(motion.valid.all()):
        raise ReconError(
            "expected clips without missing frames at their ends; continue clips of unequal "
            "length one by one"
        )
    humor = humor.like(motion.translation)
    end = motion.window(max(motion.frames - 2, 0), motion.frames)
    first = states_of(end, humor.body)[:, -1]

    def repeated(tensor: Tensor) -> Tensor:
        return tensor.expand(samples, *tensor.shape).flatten(0, 1)

    return roll_out_from(
        humor,
        first.map(repeated),
        repeated(motion.shape),
        frames,
        random,
        temperature=temperature,
        footing=footing,
        start_time=motion.stop_time,
    )


@torch.no_grad()
def sample(
    humor: Humor,
    frames: int,
    samples: int,
    random: torch.Generator,
    *,
    temperature: float = TEMPERATURE,
    footing: FootingSettings | None = _FOOTING,
) -> Decoded:
    """Draw motions: first states from the mixture of states, then a latent for every step.

    Axes (samples, frames), 30 Hz; the bodies are those that the first states ask for.
    `temperature` and `footing` are as of `roll_out_from`; the first states are drawn with the same
    temperature.

    Raises:
        ValueError: when the mixture is a released one, over numbers that repeat each other.
    """
    start = first_states(humor.initial, humor.body, samples, random, temperature)
    return roll_out_from(humor, *start, frames, random, temperature=temperature, footing=footing)


_FACING = ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
"""Root of an upright body in its canonical frame: its right along +x, so it looks along +y."""


@dataclass(frozen=True)
class _JointEnergy(TensorStruct):
    """Energy that pulls the joints of a one-frame motion to positions: ½ Σ |p - p̂|², metres²."""

    positions: Float[Tensor, "clips 22 3"]

    def __call__(self, estimate: Estimate) -> Float[Tensor, " clips"]:
        away = estimate.body.joints[:, 0] - self.positions
        return 0.5 * away.square().sum((-1, -2))


def first_states(
    initial: Mixture,
    body: BodyModel,
    count: int,
    random: torch.Generator,
    temperature: float = 1.0,
) -> tuple[State, Float[Tensor, "clips shape"]]:
    """Draw canonical first states from the mixture, and the shapes of their bodies.

    The mixture knows no rotations. They and the shape are fitted to the drawn joints under the
    pose prior; the state's joints are those of the fitted body. A body whose feet are drawn below
    the ground z = 0 is raised onto it.

    Raises:
        ValueError: when the mixture is over other numbers than ours.
    """
    if not torch.equal(initial.features.cpu(), independent_features()):
        raise ValueError(
            "first states can be drawn only from a mixture over the independent features of a "
            "state; that of HuMoR's released weights is over all features: take the weights 'open'"
        )
    drawn = initial.sample(count, random, temperature).to(body.template)
    full = drawn.new_zeros(count, 6 * len(JOINTS) + 6)
    full[:, initial.features] = drawn
    positions, velocities = (
        part.unflatten(-1, (len(JOINTS), 3)) for part in full[:, :-6].chunk(2, 1)
    )
    level = full.new_tensor([1.0, 1.0, 0.0])
    shape = full.new_zeros(count, body.shape_size)
    # the mixture lacks the pelvis's x and y (those at rest) and its velocity (the translation's)
    positions[:, 0] += body.rest_joints(shape)[:, 0] * level
    velocities[:, 0] = full[:, -6:-3]

    prior = PosePrior.load(weights=PoseWeights(pose=1e-5, shape=1e-5))
    motion = _poses_fitted_to_joints(positions, shape, body, prior)
    joints = body.pose(motion).joints[:, 0]
    touching = heights_in_contact(rest_heights(body, motion.shape))[:, FEET]
    sunk = (touching - joints[:, FEET, 2]).amax(-1).clamp(min=0)
    shift = sunk[:, None] * (1 - level) - motion.translation[:, 0] * level
    return (
        State(
            translation=motion.translation[:, 0] + shift,
            velocity=full[:, -6:-3],
            root=motion.rotations[:, 0, 0],
            angular_velocity=full[:, -3:],
            pose=motion.rotations[:, 0, 1:],
            joints=joints + shift[:, None],
            joint_velocities=velocities,
        ),
        motion.shape,
    )


def _poses_fitted_to_joints(
    positions: Float[Tensor, "clips 22 3"],
    shape: Float[Tensor, "clips shape"],
    body: BodyModel,
    prior: PosePrior,
) -> Motion:
    rotations = torch.eye(3).to(positions).repeat(len(positions), 1, len(JOINTS), 1, 1)
    rotations[:, :, 0] = positions.new_tensor(_FACING)
    pelvis = body.rest_joints(shape)[:, 0]
    start = Motion.create((positions[:, 0] - pelvis)[:, None], rotations, shape, REFERENCE_FPS)
    data = Term("joints", _JointEnergy(positions), 1.0)
    scene = Scene.create(len(positions), like=positions)
    estimate, _ = run_stages(prior.stages((data,)), body, start, scene)
    return estimate.motion.detach()
