"""Energies without data: golden values, laws, and the same meaning at any frame rate."""

import numpy as np
import pytest
import torch

from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method import terms
from recon.method.free import FreeMotion
from tests import laws
from tests.conftest import GOLDEN
from tests.filmed import bundled, walk

ENERGIES = (
    terms.shape,
    terms.joint_velocity,
    terms.joint_acceleration,
    terms.relative_acceleration,
    terms.rest_pose,
)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: e.__name__)
def test_energies_keep_their_contract(energy, toy_body):
    motion = laws.a_motion(toy_body)
    still = motion.at(torch.zeros(6, dtype=torch.float64), 30.0)
    smooth = energy not in (terms.shape, terms.rest_pose)
    laws.check_energy(energy, toy_body, motion, still if smooth else None)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: e.__name__)
def test_padding_counts_nothing(energy, toy_body):
    motion = laws.a_motion(toy_body, frames=6)
    short = laws.estimate_of(toy_body, motion.window(0, 5))
    wild = motion.rotations.clone()
    wild[:, 5:] = so3.exp(torch.randn(2, 1, 22, 3, dtype=torch.float64))
    padded = motion.replace(rotations=wild, valid=torch.arange(6).expand(2, 6) < 5)
    assert torch.allclose(energy(laws.estimate_of(toy_body, padded)), energy(short), rtol=1e-12)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: e.__name__)
def test_values_do_not_depend_on_the_frame_rate(energy, toy_body):
    t = torch.arange(0, 2.0001, 1 / 240, dtype=torch.float64)
    steps = 0.3 * torch.sin(3 * t)[:, None, None] * torch.ones(22, 3, dtype=torch.float64)
    fine = Motion.create(
        torch.sin(2 * t)[:, None] * torch.ones(3, dtype=torch.float64), so3.exp(steps),
        torch.ones(16, dtype=torch.float64), 240.0,
    ).map(lambda tensor: tensor[None])  # fmt: skip
    value = [
        energy(laws.estimate_of(toy_body, fine.resample(fps))).item() for fps in (30.0, 120.0)
    ]
    # the coarse differences miss (angular speed / fps)² of the derivative
    assert value[0] == pytest.approx(value[1], rel=0.1)


def test_a_small_walker_is_not_smoother_than_a_tall_one():
    """Before one camera, who may be small and near, smoothness made walkers a third too small."""
    tall, body = walk().replace(shape=torch.zeros(16)), bundled()
    small = tall.replace(shape=torch.tensor([-2.5, *[0.0] * 15]))
    factor = body.height(small.shape) / body.height(tall.shape)
    small = small.replace(translation=factor * small.translation)
    pair = [laws.estimate_of(body, one.map(lambda t: t[None])) for one in (small, tall)]
    near, far = (float(terms.relative_acceleration(one)) for one in pair)
    assert near == pytest.approx(far, rel=0.1)
    assert float(terms.joint_acceleration(pair[0])) < 0.75 * far


def test_golden_values(toy_body):
    with np.load(GOLDEN / "losses.npz", allow_pickle=False) as file:
        g = {key: torch.from_numpy(np.asarray(file[key], dtype=np.float64)) for key in file.files
             if file[key].dtype.kind == "f"}  # fmt: skip
    motion = Motion.create(g["camera_trans"], so3.exp(g["camera_pose"]), g["betas"], 30.0)
    estimate = laws.estimate_of(toy_body, motion)
    assert torch.allclose(estimate.body.joints, g["camera_joints"].reshape(2, 8, 22, 3), atol=1e-7)
    smooth = terms.joint_velocity(estimate).sum().item()
    assert smooth == pytest.approx(g["value_joints3d_smooth"].item(), rel=1e-6)
    assert terms.shape(estimate).sum().item() == pytest.approx(
        8 * g["value_shape_prior"].item(), rel=1e-10
    )


def test_offsets_are_half_their_square(toy_body):
    motion = laws.a_motion(toy_body)
    scene = Scene(torch.full((2, 4, 3), 0.1, dtype=torch.float64))
    value = terms.offsets(laws.estimate_of(toy_body, motion, scene))
    assert torch.allclose(value, torch.full((2,), 0.06, dtype=torch.float64))


def test_free_motion_is_exact(toy_body):
    motion = laws.a_motion(toy_body)
    laws.check_prior(FreeMotion(), motion, 1e-7)
    laws.check_heading_invariance(FreeMotion(), motion, 1.0, torch.ones(3).double())
