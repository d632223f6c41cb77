"""New motions from HuMoR: latents drawn from the conditional prior, step after step."""

from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.first import first_states
from priors.humor.prior import Humor
from priors.humor.state import State, contact_probabilities, posed_joints, states_of
from priors.humor.stepwise.drawn import drawn_step
from priors.humor.stepwise.footing import Footing
from recon.body.contacts import rest_heights, touching_heights
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.core.struct import stack
from recon.method.protocols import REFERENCE_FPS, Decoded

TEMPERATURE = 0.9
"""Factor on the standard deviations of the prior for motions that are made up: with all of the
spread, errors of steps add up to motions that leave their feet more often."""
_FOOTING = Footing()

Landing = Callable[[State, Float[Tensor, "clips 22 3"]], State]
"""A function that changes every predicted state, given the unposed joints of its body."""


def as_predicted(state: State, _: Float[Tensor, "clips 22 3"]) -> State:
    """HuMoR: the next step starts from all that the network says.

    It says twice where the body is, by joints and by translation and rotations, and with time the
    two part: the joints stay on the ground, the body does not.
    """
    return state


def joints_of_body(state: State, rest: Float[Tensor, "clips 22 3"]) -> State:
    """HuMoR-Qual: the next step starts from the joints that the body has."""
    return state.replace(joints=posed_joints(state, rest))


def body_at_joints(state: State, rest: Float[Tensor, "clips 22 3"]) -> State:
    """The body is moved to where the predicted joints are on average; its joints are the state's.

    The network knows best by its joints how high a body is.
    """
    joints = posed_joints(state, rest)
    shift = (state.joints - joints).mean(-2)
    return state.replace(
        translation=state.translation + shift, joints=joints + shift[..., None, :]
    )


@torch.no_grad()
def roll_from(
    humor: Humor,
    first: State,
    shape: Float[Tensor, "clips shape"],
    frames: int,
    random: torch.Generator | None,
    *,
    temperature: float = 1.0,
    landing: Landing = body_at_joints,
    footing: Footing | None = _FOOTING,
    start_time: float = 0.0,
) -> Decoded:
    """Random continuations of given states, which come first; axes (clips, frames), 30 Hz.

    Args:
        humor: in the states' precision and on their device.
        first: in the world, axis (clips).
        shape: of the bodies.
        frames: the first included.
        random: of the latents; None takes the prior's mean at every step.
        temperature: factor on the prior's standard deviations; above 1 draws more varied motions.
        landing: what becomes of every step's state before the next one starts from it.
        footing: how the ground holds the bodies; None leaves it to the networks.
        start_time: of the first frame, seconds.

    Raises:
        ValueError: when fewer than two frames are asked for.
    """
    if frames < 2:
        raise ReconError(f"a motion from HuMoR has two frames at least, asked for {frames}")
    touching = touching_heights(rest_heights(humor.body, shape))[:, FEET]
    draws = 1 if footing is None or random is None else footing.draws
    bodies = humor.pelvis(shape), humor.body.rest_joints(shape), touching
    pelvis, rest, low = (_repeated(tensor, draws) for tensor in bodies)
    states, logits = [first], []
    for _ in range(frames - 1):
        before = states[-1].map(partial(_repeated, count=draws))
        frame, reached, touched = drawn_step(
            humor.networks, before, pelvis, random, temperature=temperature
        )
        after = frame.leave(landing(reached, rest), pelvis)
        if footing is not None:
            if draws > 1:
                assert random is not None
                kept = footing.kept(before, after, low, random)
                after, touched = after[kept], touched[kept]
            after = footing.grounded(states[-1], after, touching)
        states.append(after)
        logits.append(touched)

    found = stack(states).map(lambda tensor: tensor.transpose(0, 1))
    contacts = contact_probabilities(torch.stack(logits, 1))
    motion = Motion.create(
        translation=found.translation,
        rotations=torch.cat((found.root[:, :, None], found.pose), 2),
        shape=shape,
        fps=REFERENCE_FPS,
        start_time=start_time,
    )
    return Decoded(motion, contacts=contacts, joints=found.joints)


def _repeated(tensor: Tensor, count: int) -> Tensor:
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
    footing: Footing | None = _FOOTING,
) -> Decoded:
    """Motions that continue the last frame of given ones; axes (samples · clips, frames), 30 Hz.

    The first frame is the motion's last. All clips of the first sample come first.

    Args:
        humor: the prior.
        motion: axes (clips, time) at any rate; its last two frames tell where to start and how
            fast.
        frames: to come, the first included.
        samples: continuations of every clip.
        random: of the latents; None takes the prior's mean at every step.
        temperature: as of `roll_from`.
        footing: as of `roll_from`.

    Raises:
        ValueError: when a clip is padded or shorter than two frames.
    """
    if not bool(motion.valid.all()):
        raise ReconError("expected clips that exist to their last frame; predict each alone")
    humor = humor.like(motion.translation)
    end = motion.window(max(motion.frames - 2, 0), motion.frames)
    first = states_of(end, humor.body)[:, -1]

    def repeated(tensor: Tensor) -> Tensor:
        return tensor.expand(samples, *tensor.shape).flatten(0, 1)

    last = motion.stop_time
    shape = repeated(motion.shape)
    return roll_from(
        humor,
        first.map(repeated),
        shape,
        frames,
        random,
        temperature=temperature,
        footing=footing,
        start_time=last,
    )


@torch.no_grad()
def sample(
    humor: Humor,
    frames: int,
    samples: int,
    random: torch.Generator,
    *,
    temperature: float = TEMPERATURE,
    footing: Footing | None = _FOOTING,
) -> Decoded:
    """Motions drawn from the prior: first states from the mixture, latents from the prior.

    Axes (samples, frames), 30 Hz; the bodies are those that the first states ask for.
    `temperature` and `footing` are as of `roll_from`; the first states are drawn with the same
    temperature.

    Raises:
        ValueError: when the mixture is a released one, over numbers that repeat each other.
    """
    first, shape = first_states(humor.initial, humor.body, samples, random, temperature)
    return roll_from(humor, first, shape, frames, random, temperature=temperature, footing=footing)
