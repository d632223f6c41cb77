import numpy as np
import pytest
import torch

from priors.anchor.frames import Anchors, CycleBasis
from priors.anchor.networks import AnchorNetworks, AnchorWeights, CodeSpread, load_weights
from priors.anchor.prior import AnchorFrames
from priors.checkpoints import load_checkpoint
from priors.cosines import cosines
from recon.body.model import BodyModel
from recon.core.motion import padded_batch
from recon.method.priors import Prior
from tests.priors.tiny_anchor import LATENT, tiny_prior, tiny_weights, walks
from training.anchor.train import fitted_basis
from training.weights import save_anchor, save_checkpoint

pytestmark = pytest.mark.numerics

BODY = BodyModel.load()
PRIOR = tiny_prior(BODY)


def _joints(motion):
    return BODY.pose(motion).joints[..., :10, :]


def test_cosines_are_orthonormal():
    waves = cosines(100, 24)
    assert torch.allclose(waves.mT @ waves, torch.eye(24, dtype=torch.float64), atol=1e-12)


def test_the_basis_gives_its_own_cycles_back():
    rows = torch.stack([Anchors.of(walk).pack() for walk in walks(BODY, 12)])
    basis = fitted_basis(rows, 6)
    back = basis.denormalised(basis.synthesise(basis.analyse(rows)))
    assert float((back - rows).abs().max()) < 0.02
    assert torch.allclose(back[:, -1, -1], rows[:, -1, -1], atol=1e-3)


def test_a_basis_needs_more_cycles_than_directions():
    rows = torch.stack([Anchors.of(walk).pack() for walk in walks(BODY, 3)])
    with pytest.raises(ValueError, match="expected more cycles"):
        fitted_basis(rows, 6)


def _rank_two_basis(residue: float) -> CycleBasis:
    """A basis of walks of which only two directions vary; rounding is left in the others."""
    basis = fitted_basis(torch.stack([Anchors.of(walk).pack() for walk in walks(BODY, 12)]), 6)
    deviation = basis.deviation.clone()
    deviation[2:] = residue * deviation[0]
    return basis.replace(deviation=deviation)


@pytest.mark.parametrize("residue", [0.0, 1e-9, 3e-7, 1.7e-6, 1e-5])
def test_directions_without_variance_are_not_blown_up(residue, tmp_path):
    """Networks divided by their deviation, which is rounding: 67,000, infinite in float16."""
    networks = AnchorNetworks(_rank_two_basis(residue), LATENT, BODY.shape_size, 16).eval()
    assert float(networks.to_code.detach().abs().max()) <= 200.001
    spread = CodeSpread(torch.zeros(LATENT), torch.eye(LATENT), torch.zeros(2, LATENT))
    path = tmp_path / "anchor.safetensors"
    save_anchor(path, AnchorWeights(networks, spread), {})
    there = load_weights(path).networks.to_code
    assert torch.allclose(there, networks.to_code.detach(), rtol=1e-2)  # of float16


def test_directions_with_variance_have_unit_variance():
    basis = fitted_basis(torch.stack([Anchors.of(walk).pack() for walk in walks(BODY, 40)]), 3)
    rows = torch.stack([Anchors.of(walk).pack() for walk in walks(BODY, 40)])
    codes = basis.analyse(rows) * basis.whitening
    assert torch.allclose(codes.std(0), torch.ones(3), atol=1e-3)


def test_it_is_a_prior():
    assert isinstance(PRIOR, Prior)


def test_encoding_and_decoding_gives_walks_back():
    motion = padded_batch(walks(BODY, 3, seed=5))
    variables = PRIOR.encode(motion)
    decoded = PRIOR.decode(variables)
    error = (_joints(decoded.motion) - _joints(motion)).norm(dim=-1)
    assert float(error.where(motion.valid[..., None], 0).max()) < 0.05
    assert decoded.motion.fps == motion.fps
    assert torch.equal(decoded.motion.valid, motion.valid)
    assert float(decoded.energies["ends"].max()) < 0.5 * 2 * 0.03**2
    assert set(decoded.energies) == {"latent", "shape", "ends", "details", "sink"}


def test_decoding_starts_where_the_motion_was():
    motion = padded_batch(walks(BODY, 1))
    moved = motion.replace(translation=motion.translation + torch.tensor([3.0, -2.0, 0.0]))
    here, there = (PRIOR.decode(PRIOR.encode(m)).motion for m in (motion, moved))
    shift = there.translation - here.translation
    assert torch.allclose(shift, torch.tensor([3.0, -2.0, 0.0]).expand_as(shift), atol=1e-4)


def test_moments_outside_the_cycle_hold_its_ends():
    motion = padded_batch(walks(BODY, 1))
    variables = PRIOR.encode(motion)
    early = variables.replace(begin=variables.begin + 4.0)  # 0.2 s later
    decoded = PRIOR.decode(early).motion
    assert torch.equal(decoded.translation[0, 0], decoded.translation[0, 5])
    assert not torch.equal(decoded.translation[0, 5], decoded.translation[0, 15])


def test_carried_variables_are_the_carried_motion():
    motion = padded_batch(walks(BODY, 2))
    variables = PRIOR.encode(motion).replace(place=torch.tensor([[0.3, 0.1, 0.2]] * 2))
    T = torch.eye(4).repeat(2, 1, 1)
    T[:, :2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])
    T[:, :3, 3] = torch.tensor([1.0, 2.0, 0.5])
    pelvis = BODY.rest_joints(motion.shape)[:, 0]
    expected = PRIOR.decode(variables).motion.carried(T, pelvis)
    found = PRIOR.decode(variables.carried(T, BODY)).motion
    assert torch.allclose(_joints(found), _joints(expected), atol=1e-4)


def test_gradients_are_right():
    motion = padded_batch(walks(BODY, 1))
    weights = tiny_weights(BODY)
    double = AnchorFrames(
        weights=type(weights)(weights.networks.double(), weights.spread.to(dtype=torch.float64)),
        body=BODY.to(dtype=torch.float64),
    )
    double.weights.networks.basis = double.weights.networks.basis.to(dtype=torch.float64)
    x = PRIOR.encode(motion).to(dtype=torch.float64)
    x = x.replace(begin=x.begin + 0.03, turn=x.turn + 0.1)

    def value(latent, turn, begin, bend):
        y = x.replace(latent=latent, turn=turn, begin=begin, bend=bend)
        return double.decode(y).motion.rotations[:, 3:-3:7, :5].sin()

    leaves = tuple(
        tensor.clone().requires_grad_() for tensor in (x.latent, x.turn, x.begin, x.bend)
    )
    assert torch.autograd.gradcheck(value, leaves, fast_mode=True)


def test_weights_survive_the_disk(tmp_path):
    weights = tiny_weights(BODY)
    save_anchor(tmp_path / "w.safetensors", weights, {"data": "open"})
    back = load_weights(tmp_path / "w.safetensors")
    code = torch.randn(3, LATENT)
    shape = torch.zeros(3, BODY.shape_size)
    one, other = (w.networks.decode(code, shape) for w in (weights, back))
    assert torch.allclose(one, other, atol=2e-2)
    assert torch.allclose(back.spread.root, weights.spread.root)


def test_weights_of_another_alignment_are_refused(tmp_path):
    """Cycles without which way is up, as published, are no longer known."""
    path = tmp_path / "w.safetensors"
    save_anchor(path, tiny_weights(BODY), {})
    found = load_checkpoint(path, "anchor")
    save_checkpoint(path, "anchor", found.tensors, {**found.settings, "alignment": "full"})
    with pytest.raises(ValueError, match=r"alignment = 'yaw'.*trained anew"):
        load_weights(path)


def test_weights_for_another_body_are_refused(tmp_path):
    save_anchor(tmp_path / "w.safetensors", tiny_weights(BODY), {})
    other = BODY.replace(
        shape_directions=BODY.shape_directions[..., :5],
        joint_directions=BODY.joint_directions[..., :5],
        male=BODY.male[:5],
        female=BODY.female[:5],
    )
    with pytest.raises(ValueError, match="16 shape coefficients"):
        AnchorFrames.load(str(tmp_path / "w.safetensors"), other)


def test_weights_of_something_else_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such weights"):
        load_weights(tmp_path / "none.safetensors")
    (tmp_path / "w.safetensors").write_bytes(np.arange(9).tobytes())
    with pytest.raises(ValueError, match="safetensors"):
        load_weights(tmp_path / "w.safetensors")
