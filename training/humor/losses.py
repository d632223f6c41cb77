"""Losses of HuMoR's networks over windows, from true states or from predicted states.

Losses follow HuMoR's section 3. What differs: joints of the body by its kinematics only (no mesh).
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from priors.humor.state import Frame, State, canonical_state, state_after_step
from priors.humor.steps import kl_divergence
from recon.body.model import forward_kinematics
from recon.core.skeleton import CONTACT_JOINTS
from recon.core.struct import TensorStruct, stack
from training.descent import drawn_code
from training.humor.corpus import StateWindows
from training.humor.scaling import ScaledNetworks


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses; for velocities, contacts and KL as published.

    Published are ones for all positions and rotations too. But in m² and (m/s)² an error of 5 mm
    weighs 900 times less than the error of velocity that makes it within a step, and steps were
    then learned to 2 cm only.
    """

    translation: float = 100.0
    joints: float = 100.0
    posed_joints: float = 100.0
    consistency: float = 100.0
    root: float = 30.0
    pose: float = 30.0
    kl: float = 4e-4
    contacts: float = 0.01
    contact_velocity: float = 0.01


@dataclass(frozen=True)
class Transition(TensorStruct):
    """Outputs of the networks for steps between states, in the frame where each step starts."""

    after: State
    contacts: Float[Tensor, "*batch 9"]
    """Logits."""
    posterior_mean: Float[Tensor, "*batch 48"]
    posterior_log_variance: Float[Tensor, "*batch 48"]
    prior_mean: Float[Tensor, "*batch 48"]
    prior_log_variance: Float[Tensor, "*batch 48"]


def unroll(
    networks: ScaledNetworks,
    windows: StateWindows,
    true_input: Bool[Tensor, " steps"],
    random: torch.Generator | None,
    half: bool = False,
) -> tuple[Transition, State]:
    """Predict all steps of windows from true or predicted states; also return target states.

    A step from an own prediction starts at that prediction, in its own frame; the state to reach
    remains the true one, in the frame of the true state before. No gradient passes from step to
    step.

    Args:
        networks: prior, encoder and decoder.
        windows: axes (windows, frames).
        true_input: for every step, whether it starts at the true state; the first always does.
        random: draws the latents; None takes their means.
        half: whether the networks multiply in bfloat16.
    """
    world = windows.states
    level = world.translation.new_tensor([1.0, 1.0, 0.0])
    pelvis = windows.rest[:, 0] * level
    past, future = world[:, :-1], world[:, 1:]
    frame = Frame.of(past)
    start, target = frame.to_frame(past, pelvis[:, None]), frame.to_frame(future, pelvis[:, None])
    if bool(true_input[1:].all()):
        return transition(networks, start, target, random, half), target
    steps: list[Transition] = []
    for k, given in enumerate(true_input.tolist()):
        state = start[:, k]
        if k > 0 and not given:
            state = canonical_state(steps[-1].after.detach(), pelvis)
        steps.append(transition(networks, state, target[:, k], random, half))
    return stack(steps).map(lambda tensor: tensor.transpose(0, 1)), target


def transition(
    networks: ScaledNetworks,
    state: State,
    target: State,
    random: torch.Generator | None,
    half: bool,
) -> Transition:
    """Predict a step: encode state and target, draw a latent, decode the next state."""
    packed = state.pack()
    with torch.autocast(packed.device.type, torch.bfloat16, enabled=half):
        mean, log_variance = networks.posterior(packed, target.pack())
        latent = drawn_code(mean.float(), log_variance.float(), random)
        raw = networks.decode(packed, latent).float()
        prior = networks.prior(packed)
    after, contacts = state_after_step(state, raw)
    return Transition(after, contacts, *(t.float() for t in (mean, log_variance, *prior)))


def loss_terms(found: Transition, target: State, windows: StateWindows) -> dict[str, Tensor]:
    """Unweighted losses, each a mean over all transitions and entries (HuMoR, section 3.2)."""
    after = found.after
    names = [field.name for field in dataclasses.fields(State)]
    losses = {
        name: functional.mse_loss(getattr(after, name), getattr(target, name)) for name in names
    }
    posed = forward_kinematics(after.rotations, windows.rest)[1] + after.translation[..., None, :]
    losses["posed_joints"] = functional.mse_loss(posed, target.joints)
    losses["consistency"] = functional.mse_loss(posed, after.joints)

    losses["kl"] = kl_divergence(
        found.posterior_mean, found.posterior_log_variance,
        found.prior_mean, found.prior_log_variance,
    ).mean()  # fmt: skip

    trusted = windows.trusted[:, None, None].expand(found.contacts.shape).to(found.contacts)
    count = trusted.sum().clamp(min=1)
    entropy = functional.binary_cross_entropy_with_logits(
        found.contacts, windows.contacts[:, 1:], reduction="none"
    )
    losses["contacts"] = (entropy * trusted).sum() / count
    speed = after.joint_velocities[..., list(CONTACT_JOINTS), :].square().sum(-1)
    losses["contact_velocity"] = (found.contacts.sigmoid() * speed * trusted).sum() / count
    return losses


def total_loss(losses: Mapping[str, Tensor], kl: float, weights: LossWeights) -> Tensor:
    """Weighted sum of all losses; `kl` (0 to 1) anneals the weight of the KL divergence."""
    given = dataclasses.asdict(weights) | {"kl": kl * weights.kl}
    return torch.stack([given.get(name, 1.0) * value for name, value in losses.items()]).sum()
