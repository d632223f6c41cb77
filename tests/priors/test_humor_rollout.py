"""Roll-outs, their gradients and sequence inference against golden numbers; laws of the loop."""

import pytest
import torch
from torch import Tensor

from priors.humor.networks import HumorNetworks
from priors.humor.state import Frame, State, canonical_state, rest_pelvis, state_after_step
from priors.humor.unrolled import FrozenDecoder, Rollout, roll_out
from recon.core import rotations as so3
from tests.priors.test_humor_nets import golden, made_up_networks

PARTS = ("trans", "trans_vel", "root_orient", "root_orient_vel", "pose_body", "joints")
PARTS = (*PARTS, "joints_vel")


@pytest.fixture(scope="module")
def networks() -> HumorNetworks:
    return made_up_networks()


def packed(g: dict[str, Tensor], prefix: str) -> Tensor:
    return torch.cat([g[f"{prefix}_{name}"] for name in PARTS], -1)


def world_rollout(networks: HumorNetworks, start: State, z: Tensor) -> tuple[Rollout, State]:
    pelvis = rest_pelvis(start)
    frame = Frame.of(start)
    rollout = roll_out(
        FrozenDecoder.of(networks.decoder), frame.to_frame(start, pelvis).pack(), pelvis, z
    )
    return rollout, rollout.in_world(frame, pelvis)


@pytest.mark.parametrize("kind", ["canonical", "world"])
def test_rollout_equals_the_exact_reference(networks: HumorNetworks, kind: str) -> None:
    g = golden("humor_rollout")
    start = State.unpack(packed(g, f"init_{kind}"))
    rollout, world = world_rollout(networks, start, g["z"])
    expected = packed(g, f"{kind}_exact")
    torch.testing.assert_close(world.pack(), expected, rtol=0, atol=1e-7)  # metres
    torch.testing.assert_close(rollout.contacts, g[f"{kind}_exact_contacts"], rtol=0, atol=1e-7)
    torch.testing.assert_close(rollout.inputs, g[f"{kind}_exact_net_in"], rtol=0, atol=1e-7)
    mean, log_variance = networks.prior(rollout.inputs)
    torch.testing.assert_close(mean, g[f"{kind}_exact_prior_mean"], rtol=0, atol=1e-7)
    torch.testing.assert_close(log_variance.exp(), g[f"{kind}_exact_prior_var"], rtol=0, atol=1e-7)
    reference = packed(g, f"{kind}_ref")
    torch.testing.assert_close(world.pack(), reference, rtol=0, atol=1e-3)  # its arc cosine


def test_single_precision_is_enough(networks: HumorNetworks) -> None:
    g = {k: v.float() for k, v in golden("humor_rollout").items()}
    start = State.unpack(packed(g, "init_world"))
    single = made_up_networks().float()
    _, world = world_rollout(single, start, g["z"])
    torch.testing.assert_close(world.pack(), packed(g, "world_exact"), rtol=0, atol=1e-5)


def test_gradients_equal_the_reference(networks: HumorNetworks) -> None:
    g = golden("humor_rollout")
    given = State.unpack(packed(g, "init_world"))
    root_left = torch.zeros(2, 3, dtype=torch.float64)
    pose_left = torch.zeros(2, 21, 3, dtype=torch.float64)
    leaves = {
        "z": g["z"],
        "trans": given.translation,
        "trans_vel": given.velocity,
        "root_orient_vel": given.angular_velocity,
        "joints": given.joints,
        "joints_vel": given.joint_velocities,
        "root_left": root_left,
        "pose_left": pose_left,
    }
    leaves = {name: value.clone().requires_grad_() for name, value in leaves.items()}
    start = State(
        translation=leaves["trans"],
        velocity=leaves["trans_vel"],
        root=so3.exp(leaves["root_left"]) @ given.root,
        angular_velocity=leaves["root_orient_vel"],
        pose=so3.exp(leaves["pose_left"]) @ given.pose,
        joints=leaves["joints"],
        joint_velocities=leaves["joints_vel"],
    )
    rollout, world = world_rollout(networks, start, leaves["z"])
    mean, log_variance = networks.prior(rollout.inputs)
    found = dict(zip(PARTS, world.tensors().values(), strict=True))
    found |= {"contacts": rollout.contacts, "prior_mean": mean, "prior_var": log_variance.exp()}
    terms = [(g[f"grad_coef_{k}"] * v.reshape(2, 12, -1)).sum() for k, v in found.items()]
    value = torch.stack(terms).sum()
    torch.testing.assert_close(value, g["grad_value"], rtol=1e-9, atol=0)
    gradients = torch.autograd.grad(value, list(leaves.values()))
    for name, gradient in zip(leaves, gradients, strict=True):
        expected = g[f"grad_{name}"].reshape(gradient.shape)
        scale = float(expected.abs().max())
        torch.testing.assert_close(gradient, expected, rtol=0, atol=1e-6 * scale)


def test_inference_along_a_sequence_equals_the_reference(networks: HumorNetworks) -> None:
    g = golden("humor_rollout")
    world = State.unpack(packed(g, "seq"))
    past, future = world[:, :-1], world[:, 1:]
    pelvis = rest_pelvis(world[:, :1])
    frame = Frame.of(past)
    start, following = (frame.to_frame(s, pelvis).pack() for s in (past, future))
    mean, log_variance = networks.prior(start)
    torch.testing.assert_close(mean, g["infer_exact_prior_mean"], rtol=0, atol=1e-10)
    torch.testing.assert_close(log_variance.exp(), g["infer_exact_prior_var"], rtol=0, atol=1e-10)
    mean, log_variance = networks.posterior(start, following)
    torch.testing.assert_close(mean, g["infer_exact_post_mean"], rtol=0, atol=1e-10)
    torch.testing.assert_close(log_variance.exp(), g["infer_exact_post_var"], rtol=0, atol=1e-10)


def test_canonical_frames_are_undone_by_leaving_them() -> None:
    g = golden("humor_rollout")
    world = State.unpack(packed(g, "seq"))
    frame, pelvis = Frame.of(world), rest_pelvis(world)
    inside = frame.to_frame(world, pelvis)
    torch.testing.assert_close(
        frame.from_frame(inside, pelvis).pack(), world.pack(), rtol=0, atol=1e-12
    )
    assert inside.translation[..., :2].abs().max() < 1e-15  # metres
    assert inside.root[..., 1, 0].abs().max() < 1e-12  # the right side is along +x
    assert (inside.root[..., 0, 0] <= 0).all()


def test_the_loop_is_the_plain_recursion() -> None:
    """With states as records, composed and canonicalised one by one."""
    torch.manual_seed(1)
    networks = HumorNetworks(64).double().requires_grad_(False)
    start = State.unpack(packed(golden("humor_rollout"), "init_canonical"))
    pelvis = rest_pelvis(start)
    z = torch.randn(2, 5, 48, dtype=torch.float64)
    decoder = FrozenDecoder.of(networks.decoder)
    rollout = roll_out(decoder, start.pack(), pelvis, z)
    state = start
    for k in range(5):
        torch.testing.assert_close(rollout.inputs[:, k], state.pack(), rtol=0, atol=1e-9)
        after, contacts = state_after_step(state, networks.decode(state.pack(), z[:, k]))
        torch.testing.assert_close(rollout.states[:, k].pack(), after.pack(), rtol=0, atol=1e-9)
        torch.testing.assert_close(rollout.contacts[:, k], contacts, rtol=0, atol=1e-9)
        state = canonical_state(after, pelvis)


def test_a_body_on_its_side_rolls_on_without_nan() -> None:
    """Its heading is undefined; it keeps the one it had."""
    networks = HumorNetworks(64).double().requires_grad_(False)
    for parameter in networks.decoder.parameters():
        parameter.zero_()
    start = State.unpack(packed(golden("humor_rollout"), "init_canonical"))
    lying = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=torch.float64)
    start = start.replace(root=lying.expand(2, 3, 3))
    z = torch.zeros(2, 3, 48, dtype=torch.float64)
    start = start.map(lambda tensor: tensor.clone().requires_grad_())
    pelvis = rest_pelvis(start)
    rollout = roll_out(FrozenDecoder.of(networks.decoder), start.pack(), pelvis, z)
    world = rollout.in_world(Frame.of(start), pelvis)
    torch.testing.assert_close(world.root[:, -1], start.root, rtol=0, atol=1e-12)
    for gradient in torch.autograd.grad(world.pack().sum(), list(start.tensors().values())):
        assert gradient.isfinite().all()
