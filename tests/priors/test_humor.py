"""Laws of HuMoR as a prior, its weights files and its predictions."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from priors.checkpoints import load_checkpoint
from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.prior import Humor
from priors.humor.state import (
    Frame,
    canonical_state,
    independent_features,
    initial_features,
    rest_pelvis,
    states_of,
)
from priors.humor.unrolled import FrozenDecoder, roll_out
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, padded_batch
from recon.method.priors import Prior
from tests.laws import check_heading_invariance, check_prior
from tests.priors.test_pose import swinging
from training.weights import save_checkpoint, save_humor


def humor(body: BodyModel, still: bool = False, width: int = 64) -> Humor:
    """An untrained prior; or one that never moves."""
    torch.manual_seed(2)
    networks = HumorNetworks(width).to(body.template.dtype).requires_grad_(False)
    for parameter in networks.decoder.net[9].parameters():
        parameter.mul_(0.0 if still else 0.02)
    features = independent_features()
    size = len(features)
    covariances = torch.eye(size, dtype=torch.float64).expand(2, size, size)
    means = torch.stack((torch.zeros(size), torch.ones(size))).double()
    mixture = Mixture.create(torch.tensor([0.4, 0.6]), means, covariances, features)
    return Humor(networks, mixture, body, torch.eye(207, dtype=torch.float64))


def motions(frames: int = 8) -> Motion:
    return padded_batch([swinging(frames, 20), swinging(frames, 21)])


def test_it_keeps_the_laws_of_priors(body: BodyModel) -> None:
    prior = humor(body)
    assert isinstance(prior, Prior)
    motion = motions()
    shift = torch.tensor([1.0, -2.0, 0.0], dtype=torch.float64)
    check_heading_invariance(prior, motion, 0.7, shift)
    check_heading_invariance(prior, motion, 3.1, shift)
    held = torch.zeros(8, dtype=torch.long)
    still = motion.replace(
        translation=motion.translation[:, held], rotations=motion.rotations[:, held]
    )
    check_prior(humor(body, still=True), still, tolerance=1e-6)  # radians, metres


def test_latents_of_its_own_motions_are_what_moved_it(body: BodyModel) -> None:
    """The first frame is kept exactly, and energies are those of the networks' words."""
    prior = humor(body)
    variables = prior.encode(motions())
    decoded = prior.decode(variables)
    torch.testing.assert_close(decoded.motion.rotations[:, 0], motions().rotations[:, 0])
    torch.testing.assert_close(decoded.motion.translation[:, 0], motions().translation[:, 0])
    assert decoded.contacts is not None
    assert decoded.joints is not None
    assert torch.equal(decoded.contacts[:, 0], decoded.contacts[:, 1])
    assert (decoded.contacts[..., [1, 2, 3, 6, 9]] == 0).all()
    states = states_of(motions(), body)[:, 0]
    start = canonical_state(states, rest_pelvis(states))
    torch.testing.assert_close(
        decoded.energies["initial"], prior.initial.energy(initial_features(start))
    )
    mean, log_variance = prior.networks.prior(start.pack())
    density = torch.distributions.Normal(mean, (0.5 * log_variance).exp())
    one = prior.decode(
        variables.replace(latents=variables.latents[:, :1], valid=variables.valid[:, :2])
    )
    expected = -density.log_prob(variables.latents[:, 0]).sum(-1)
    torch.testing.assert_close(one.energies["transition"], expected)


def test_latents_are_posterior_means_along_the_roll_out(body: BodyModel) -> None:
    """The k-th is that of the step from the k-th decoded state to the motion's next one."""
    prior = humor(body)
    motion = motions()
    variables = prior.encode(motion)
    states = states_of(motion, body)
    pelvis = rest_pelvis(states[:, 0])
    frame = Frame.of(states[:, 0])
    start = frame.to_frame(states[:, 0], pelvis).pack()
    decoder = FrozenDecoder.of(prior.networks.decoder)
    rollout = roll_out(decoder, start, pelvis, variables.latents)
    inside = rollout.canonical_frames(frame).to_frame(states[:, 1:], pelvis[:, None]).pack()
    mean, _ = prior.networks.posterior(rollout.inputs, inside)
    torch.testing.assert_close(variables.latents, mean, rtol=0, atol=1e-9)


def test_padding_changes_nothing(body: BodyModel) -> None:
    prior = humor(body)
    alone = prior.decode(prior.encode(swinging(6, 20)[None]))
    padded = prior.decode(prior.encode(padded_batch([swinging(6, 20), swinging(9, 21)])))
    torch.testing.assert_close(padded.motion.rotations[:1, :6], alone.motion.rotations)
    for name, energy in alone.energies.items():
        torch.testing.assert_close(padded.energies[name][:1], energy)
    assert torch.equal(padded.motion.valid.sum(1), torch.tensor([6, 9]))


def test_the_first_frames_alone_are_the_first_frames(body: BodyModel) -> None:
    prior = humor(body)
    variables = prior.encode(motions())
    whole, part = prior.decode(variables), prior.decode(variables.first_frames(5))
    assert part.motion.frames == 5
    torch.testing.assert_close(part.motion.rotations, whole.motion.rotations[:, :5])
    torch.testing.assert_close(part.motion.translation, whole.motion.translation[:, :5])
    torch.testing.assert_close(part.energies["initial"], whole.energies["initial"])
    cut = variables.replace(valid=variables.valid & (torch.arange(8) < 5))
    torch.testing.assert_close(
        part.energies["transition"], prior.decode(cut).energies["transition"]
    )


def test_other_rates_are_brought_to_30_hz(body: BodyModel) -> None:
    found = humor(body).encode(swinging(25, 3, fps=60.0)[None])
    assert found.latents.shape == (1, 12, 48)


def test_velocities_are_those_of_the_motion(body: BodyModel) -> None:
    time = torch.arange(7, dtype=torch.float64)[:, None] / 30
    velocity = torch.tensor([0.4, -0.2, 0.1], dtype=torch.float64)
    spin = torch.tensor([0.3, 0.5, -2.0], dtype=torch.float64)
    still = swinging(1, 4)
    rotations = still.rotations.expand(7, 22, 3, 3)
    roots = so3.exp(time * spin) @ rotations[:, 0]
    motion = Motion.create(
        time * velocity, torch.cat((roots[:, None], rotations[:, 1:]), 1), still.shape, 30.0
    )[None]
    states = states_of(motion, body)
    torch.testing.assert_close(states.velocity, velocity.expand(1, 7, 3))
    torch.testing.assert_close(states.angular_velocity, spin.expand(1, 7, 3))
    torch.testing.assert_close(states.joint_velocities[..., 0, :], states.velocity)
    around = (states.joints - states.joints[..., :1, :])[:, 3]
    turning = torch.linalg.cross(spin.expand_as(around), around) + velocity
    torch.testing.assert_close(states.joint_velocities[:, 3], turning, rtol=0, atol=5e-3)  # m/s
    with pytest.raises(ValueError, match="two frames"):
        states_of(motion.window(0, 1), body)


def test_decoding_has_the_right_derivative(body: BodyModel) -> None:
    prior = humor(body)
    start = prior.encode(motions(4))
    names = ("translation", "root", "pose", "velocity", "joint_velocities", "latents", "shape")

    def decoded(*values: Tensor) -> Tensor:
        found = prior.decode(start.replace(**dict(zip(names, values, strict=True))))
        energy = found.energies["transition"].sum() + found.energies["initial"].sum()
        assert found.joints is not None
        return torch.cat((found.motion.rotations.flatten(), found.joints.flatten())) * energy

    inputs = [getattr(start, name).clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(decoded, inputs, fast_mode=True)


def test_it_works_in_either_precision(body: BodyModel) -> None:
    prior = humor(BodyModel.load())
    motion = motions()
    single = prior.decode(prior.encode(motion.to(dtype=torch.float32))).motion
    double = prior.decode(prior.encode(motion)).motion
    assert single.rotations.dtype == torch.float32
    torch.testing.assert_close(single.rotations.double(), double.rotations, rtol=0, atol=1e-4)


def test_weights_files(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    prior = humor(BodyModel.load())
    path = tmp_path / "humor.safetensors"
    save_humor(path, prior.networks, prior.initial, prior.error_whitening, {"data": "open"})
    loaded = Humor.load(path)
    assert loaded.networks.width == 64
    assert load_checkpoint(path, "humor").settings == {"data": "open", "width": 64}
    for name, value in prior.networks.state_dict().items():
        torch.testing.assert_close(
            loaded.networks.state_dict()[name], value, rtol=2e-3, atol=1e-6
        )  # half precision
    torch.testing.assert_close(loaded.initial.means, prior.initial.means.float())

    released = tmp_path / "best_model.pth"
    torch.save({"model": prior.networks.state_dict(), "epoch": 3}, released)
    mixture = tmp_path / "prior_gmm.npz"
    identity = np.broadcast_to(np.eye(138), (2, 138, 138))
    np.savez(mixture, weights=[0.5, 0.5], means=np.zeros((2, 138)), covariances=identity)
    own = Humor.load(released, mixture=mixture)
    assert "SMPL-H" in caplog.text
    assert len(own.initial.features) == 138
    assert torch.equal(
        own.networks.state_dict()["encoder.net.0.weight"], prior.networks.encoder.net[0].weight
    )

    torch.save({"weights": torch.zeros(1)}, released)
    with pytest.raises(ValueError, match=r"best_model\.pth.*'model'"):
        Humor.load(released, mixture=mixture)
    released.write_bytes(b"something else")
    with pytest.raises(ValueError, match=r"best_model\.pth"):
        Humor.load(released, mixture=mixture)
    with pytest.raises(FileNotFoundError, match="absent"):
        Humor.load(tmp_path / "absent.pth")
    tensors = load_checkpoint(path, "humor").tensors
    save_checkpoint(path, "humor", {k: v for k, v in tensors.items() if "decoder" not in k}, {})
    with pytest.raises(ValueError, match=r"decoder\.net\.0\.weight is missing"):
        Humor.load(path)
    save_checkpoint(path, "humor", {k: v for k, v in tensors.items() if "means" not in k}, {})
    with pytest.raises(ValueError, match="means is missing"):
        Humor.load(path)
