"""The HUMOS prior: exact beside its codes, another body in its place, codes that follow."""

import math
from functools import partial

import pytest
import torch

from observations.joints3d import Joints3D
from priors.humos.collocation import CollocatedHumos
from priors.humos.frames import lowest_heights
from priors.humos.networks import load_weights
from priors.humos.prior import FPS, Humos
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from recon.core import rotations as so3
from recon.core.struct import stack
from recon.method.reconstruction import solve
from tests import laws
from tests.priors.tiny_humos import tiny_prior, tiny_weights
from tests.walking import a_walk
from training.humos.train import fitted_codes
from training.weights import save_humos

BODY = BodyModel.load()


@pytest.fixture(scope="module")
def prior() -> Humos:
    return tiny_prior(BODY)


def walks(fps=30.0, seconds=1.9):
    found = [a_walk(BODY, seconds=seconds, period=p, fps=fps) for p in (0.8, 1.1)]
    return stack(found)


@pytest.mark.parametrize("fps", [20.0, 30.0, 120.0])
def test_encoding_is_exact_at_any_rate(fps):
    laws.check_prior(tiny_prior(BODY), walks(fps), tolerance=2e-4)


def test_codes_do_not_see_heading(prior):
    turn = torch.tensor([0.4, -2.0, 0.0])
    motion = walks()
    here = prior.encode(motion)
    moved = motion.carried(_about_z(1.2, turn), BODY.rest_joints(motion.shape)[:, 0])
    there = prior.encode(moved)
    torch.testing.assert_close(there.latent, here.latent, atol=1e-3, rtol=0)


def test_another_body_stands_on_the_ground(prior):
    motion = walks()
    found = prior.encode(motion)
    shape = torch.randn(motion.shape.shape, generator=torch.Generator().manual_seed(0))
    made = prior.decode(found.replace(shape=shape)).motion
    before, after = lowest_heights(BODY.pose(motion)), lowest_heights(BODY.pose(made))
    legs = leg_length(BODY, shape) / leg_length(BODY, motion.shape)
    torch.testing.assert_close(after, before * legs[:, None], atol=2e-3, rtol=0)


def test_steps_turn_and_move_the_motion(prior):
    found = prior.encode(walks())
    plain = prior.decode(found).motion
    moved = prior.decode(found.replace(turn=found.turn + 1.0, place=found.place + 2.0)).motion
    start = plain.translation[:, 0] + BODY.rest_joints(plain.shape)[:, 0]
    later = moved.translation[:, 0] + BODY.rest_joints(moved.shape)[:, 0]
    torch.testing.assert_close((later - start)[:, :2], torch.full((2, 2), 0.2), atol=1e-4, rtol=0)
    turn = moved.rotations[:, :, 0] @ plain.rotations[:, :, 0].mT
    angle = torch.atan2(turn[..., 1, 0], turn[..., 0, 0])
    torch.testing.assert_close(angle, torch.full_like(angle, 0.2), atol=1e-4, rtol=0)


def test_variables_can_be_carried(prior):
    found = prior.encode(walks())
    found = found.replace(place=found.place + torch.tensor([0.5, -1.0]))
    T = _about_z(0.7, torch.tensor([1.0, 2.0, 0.0]))
    direct = prior.decode(found).motion.carried(T, BODY.rest_joints(found.shape)[:, 0])
    carried = prior.decode(found.carried(T, BODY)).motion
    torch.testing.assert_close(carried.translation, direct.translation, atol=1e-4, rtol=0)
    torch.testing.assert_close(carried.rotations, direct.rotations, atol=1e-4, rtol=0)


def test_density_is_that_of_codes_one_after_the_other():
    """Against the joint normal distribution of three codes."""
    random = torch.Generator().manual_seed(0)
    before = torch.randn(500, 3, generator=random)
    after = 0.6 * before + 0.5 * torch.randn(500, 3, generator=random)
    density = fitted_codes(torch.cat((before, after)), torch.full((3,), 0.01), (before, after))
    u = torch.randn(1, 3, 3, generator=random)
    exists = torch.ones(1, 3, dtype=torch.bool)
    follow, rest = density.follow.double(), density.rest.double()
    blocks = [torch.eye(3, dtype=torch.float64)]
    for _ in range(2):
        blocks.append(follow @ blocks[-1] @ follow.mT + rest @ rest.mT)
    full = torch.zeros(9, 9, dtype=torch.float64)
    for i in range(3):
        for j in range(i, 3):
            piece = torch.linalg.matrix_power(follow, j - i) @ blocks[i]
            full[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = piece
            full[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = piece.mT
    flat = u.double().flatten()
    expected = 0.5 * flat @ torch.linalg.solve(full, flat)
    assert float(density.energy(u, exists)) == pytest.approx(float(expected), rel=1e-4)
    torch.testing.assert_close(density.whitened(density.codes(u)), u, atol=1e-4, rtol=0)
    first = exists & (torch.arange(3) < 1)
    assert float(density.energy(u, first)) == pytest.approx(
        0.5 * float(u[0, 0].square().sum()), rel=1e-5
    )


def test_codes_of_long_clips_do_not_grow():
    density = Humos.load("open").weights.density
    white = density.whitened(density.drawn_codes(64, 300, torch.Generator().manual_seed(0)))
    assert float(white[:, 0].square().mean()) == pytest.approx(1, rel=0.1)
    assert float(white[:, -1].square().mean()) == pytest.approx(1, rel=0.1)
    assert float(torch.linalg.matrix_norm(density.follow, 2)) < 1


def test_drawn_codes_are_spread_as_the_density_says():
    weights = tiny_weights(BODY)
    drawn = weights.density.drawn_codes(4000, 3, torch.Generator().manual_seed(0))
    white = weights.density.whitened(drawn)
    exists = torch.ones(4000, 3, dtype=torch.bool)
    mean = float(weights.density.energy(white, exists).mean())
    assert mean == pytest.approx(0.5 * white[0].numel(), rel=0.05)


def test_samples_are_motions_of_their_bodies():
    prior = tiny_prior(BODY)
    shape = torch.zeros(2, BODY.shape_size)
    made = prior.sample(shape, 1.5, torch.Generator().manual_seed(0))
    again = prior.sample(shape, 1.5, torch.Generator().manual_seed(0))
    assert made.fps == FPS
    assert made.frames == 31
    assert bool(made.translation.isfinite().all())
    torch.testing.assert_close(made.translation, again.translation)
    assert float(lowest_heights(BODY.pose(made)).abs().max()) < 0.2
    with pytest.raises(ValueError, match="at least 1 second"):
        prior.sample(shape, 0.5, torch.Generator())


def test_weights_survive_the_disk(tmp_path):
    weights = tiny_weights(BODY)
    sizes = {"codes": "windows", "latent": 6, "basis": 16,
             "shape": BODY.shape_size, "width": 16, "layers": 1}  # fmt: skip
    path = tmp_path / "humos.safetensors"
    save_humos(path, weights, sizes)
    found = load_weights(path)
    motion = walks()
    one, other = (Humos(w, BODY).encode(motion).latent for w in (weights, found))
    torch.testing.assert_close(one, other, atol=0.05, rtol=0.02)
    save_humos(path, weights, sizes | {"codes": "words"})
    with pytest.raises(ValueError, match="codes = 'windows'"):
        load_weights(path)


@pytest.mark.numerics
def test_a_fit_is_better_than_what_was_seen(prior):
    motion = walks(seconds=1.3)
    joints = BODY.pose(motion).joints
    noise = 0.03 * torch.randn(joints.shape, generator=torch.Generator().manual_seed(0))
    every = torch.ones(joints.shape[:-1], dtype=torch.bool)
    seen = Joints3D(joints + noise, every, tuple(range(22)), motion.fps)
    found = solve([seen], partial(prior.stages, noise=0.03), BODY)
    error = (BODY.pose(found.motion).joints - joints).norm(dim=-1).mean()
    assert float(error) < 0.5 * float(noise.norm(dim=-1).mean())
    assert found.failed == (False, False)


def test_a_motion_is_judged_as_a_whole(prior):
    """What the networks know costs less than the same with frames in disorder."""
    whole = CollocatedHumos(prior)
    laws.check_prior(whole, walks(), tolerance=1e-3)
    motion = walks()
    order = torch.randperm(motion.frames, generator=torch.Generator().manual_seed(0))
    mixed = motion.replace(rotations=motion.rotations[:, order])
    good, bad = (whole.decode(whole.encode(m)).energies for m in (motion, mixed))
    assert bool((good["error"] < 0.5 * bad["error"]).all())
    short = motion.replace(valid=motion.valid & (torch.arange(motion.frames) < 40))
    cut = whole.decode(whole.encode(short)).energies["error"]
    assert bool((cut < good["error"] + 1).all())


def test_padding_counts_nothing(prior):
    motion = walks()
    short = motion.replace(valid=motion.valid.clone())
    short.valid[:, 30:] = False
    full, cut = prior.encode(short), prior.encode(motion.window(0, 30))
    exists = prior.decode(full).energies["latent"]
    alone = prior.decode(cut).energies["latent"]
    assert bool((exists < 3 * alone + 5).all())
    assert math.isfinite(float(exists.sum()))


def _about_z(angle, shift):
    return so3.rigid(so3.about_z(torch.tensor(angle)), shift).expand(2, 4, 4)
