"""Standard deviations of single points: what they weigh, and that parts keep them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import recon
from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from observations.noise import estimate_noise
from recon.core.errors import ReconError
from recon.core.residuals import geman_mcclure
from recon.core.skeleton import JOINTS
from recon.diagnosis.named_points import NamedPoints
from recon.formats.observations import PositionsFile
from recon.reading.points import positions_of
from tests import laws
from tests.filmed import bundled, walk
from tests.observations.test_points3d import seen_exactly

KINDS = pytest.mark.parametrize("kind", [Joints3D, Markers3D])


def displaced(body, motion, along=0.02):
    """An estimate whose points are all off by the same vector."""
    return laws.estimate_of(body, motion.replace(translation=motion.translation + along))


def some_std(seen, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 0.005 + 0.02 * torch.rand(seen.visible.shape, generator=generator, dtype=torch.float64)


@KINDS
def test_a_point_of_twice_the_deviation_counts_a_quarter(kind, toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(kind, toy_body, motion)
    std = torch.full(seen.visible.shape, 0.01).double()
    std[..., 0] = 0.02
    weighted, estimate = seen.replace(std=std), displaced(toy_body, motion)

    def share(point):
        alone = torch.arange(std.shape[-1]) == point
        return weighted.derived(visible=alone.expand_as(seen.visible))(estimate)

    torch.testing.assert_close(share(0), share(1) / 4)
    torch.testing.assert_close(
        weighted.residuals(estimate).weights[..., 0] * 2,
        weighted.residuals(estimate).weights[..., 1],
    )


@KINDS
@pytest.mark.parametrize("shape", [(), (1,), (6, 1), (6, -1), (2, 6, -1)])
def test_equal_deviations_change_nothing(kind, shape, toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(kind, toy_body, motion)
    std = np.full([seen.visible.shape[-1] if n == -1 else n for n in shape], 0.013)
    estimate = displaced(toy_body, motion)
    for dtype in (torch.float32, torch.float64):
        alike = seen.to(dtype=dtype).replace(std=std)
        assert torch.equal(alike(estimate), seen.to(dtype=dtype)(estimate))
    noise = alike.noise(motion, toy_body)
    assert noise.own == noise.metres == pytest.approx(0.013)


def test_deviations_in_metres_are_the_noise_unless_it_is_given(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(Joints3D, toy_body, motion)
    std = torch.full(seen.visible.shape, 0.01)
    std[..., ::2] = 0.03
    weighted = seen.replace(std=std)
    assert weighted.noise(motion, toy_body).own == pytest.approx(np.sqrt((1e-4 + 9e-4) / 2))
    assert weighted.noise(motion, toy_body, 0.5).own == 0.5
    assert seen.noise(motion, toy_body).own == estimate_noise(seen.positions, seen.visible)
    # with the noise it stands for, the energy is ½ |r / std|² in units of that noise
    estimate = displaced(toy_body, motion)
    expected = 0.5 * (3 * 0.02**2 / std.double() ** 2).sum((-2, -1))
    value = weighted(estimate) / weighted.noise(motion, toy_body).own ** 2
    torch.testing.assert_close(value, expected, rtol=1e-6, atol=0.0)


@KINDS
def test_invisible_points_have_no_influence(kind, toy_body):
    motion = laws.a_motion(toy_body)
    seen, estimate = seen_exactly(kind, toy_body, motion), displaced(toy_body, motion)
    visible = seen.visible.clone()
    visible[:, 2, 1] = visible[:, :, 3] = False
    std = some_std(seen)
    nonsense = std.where(visible, -torch.inf)
    one, other = (seen.replace(visible=visible, std=values) for values in (std, nonsense))
    assert torch.equal(one(estimate), other(estimate))
    assert torch.equal(one.std, other.std)
    assert (one.std[~visible] == 0).all()
    assert one.rms_std == other.rms_std
    assert not one.residuals(estimate).seen[~visible].any()


@KINDS
def test_parts_of_a_recording_weigh_as_the_whole_does(kind, toy_body):
    motion = laws.a_motion(toy_body, frames=12)
    seen = seen_exactly(kind, toy_body, motion)
    seen, estimate = seen.replace(std=some_std(seen)), displaced(toy_body, motion)
    parts = [seen.window(a, b) for a, b in ((-1.0, 0.15), (0.15, 5.0))]
    assert [part.std.shape == part.visible.shape for part in parts] == [True, True]
    torch.testing.assert_close(sum(part(estimate) for part in parts), seen(estimate))
    assert all(part.rms_std == seen.rms_std for part in parts)
    torch.testing.assert_close(seen[1].std, seen.std[1])
    assert seen[1].rms_std == seen.rms_std
    coarse = seen.coarse(toy_body, 2)
    assert torch.equal(coarse.std, seen.std[:, ::2])
    assert seen.to(dtype=torch.float32).std.dtype == torch.float32
    turned = seen.transformed(np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert torch.equal(turned.std, seen.std)


def test_energies_with_deviations_keep_their_contract(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(Joints3D, toy_body, motion)
    laws.check_energy(seen.replace(std=some_std(seen)), toy_body, motion, motion)


def test_a_robust_kernel_bounds_residuals_in_deviations(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(Joints3D, toy_body, motion)
    std = torch.full(seen.visible.shape, 0.01).double()
    std[..., 0] = 0.02
    robust = seen.replace(std=std).robust_beyond(0.05)
    estimate = displaced(toy_body, motion)
    w = robust.residuals(estimate).weights
    expected = 0.5 * geman_mcclure(w.square() * 3 * 0.02**2, 0.05).sum((-2, -1))
    torch.testing.assert_close(robust(estimate), expected)


@KINDS
@pytest.mark.parametrize(
    ("std", "said"),
    [
        (0.0, "measured point of 1e-06 to 100 m, got 0"),
        (-0.01, "measured point"),
        (np.nan, "measured point"),
        (np.full(3, 0.01), r"broadcasts to \(2, 6"),
        ("wide", "std: expected an array of numbers"),
    ],
)
def test_what_is_no_deviation_is_refused_by_name(kind, std, said, toy_body):
    seen = seen_exactly(kind, toy_body, laws.a_motion(toy_body))
    with pytest.raises(ReconError, match=rf"{kind.__name__}.*{said}"):
        seen.replace(std=std)


def test_names_that_are_exchanged_back_take_their_deviations_along(toy_body):
    seen = seen_exactly(Joints3D, toy_body, laws.a_motion(toy_body, clips=1))
    seen = seen.replace(std=some_std(seen))
    named = NamedPoints.of(seen, toy_body)
    moments = np.arange(6) < 3
    order = list(range(22))
    order[4], order[5] = 5, 4
    back = named.permuted(tuple(order), moments).observation
    assert torch.equal(back.std[0, :3, 4], seen.std[0, :3, 5])
    assert torch.equal(back.std[0, 3:, 4], seen.std[0, 3:, 4])
    hidden = named.without(np.eye(6, 22, dtype=bool)).observation
    assert (hidden.std[0][torch.eye(6, 22).bool()] == 0).all()
    assert replace(named, std=None).observation.std is None


def test_files_tell_deviations_in_the_unit_of_their_positions(body):
    joints = body.joint_template.double().numpy()[None] * 1000
    visible = np.ones((1, 22), bool)
    visible[0, 3] = False
    names = JOINTS
    file = PositionsFile("joints3d", joints, visible, names, 30.0, std=10.0 * visible)
    seen = positions_of(file, "a.npz", body, unit="mm", up="y")
    assert seen.rms_std == pytest.approx(0.01)
    assert float(seen.std[0, 0, 3]) == 0.0


def test_points_that_are_said_to_be_sure_lead_the_fit():
    truth = bundled().pose(walk(12)).joints
    std = torch.full((12, 22), 0.01)
    std[:, ::2] = 0.08
    noise = torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))
    seen = Joints3D(truth + std[..., None] * noise, std > 0, range(22), 30.0)
    errors = [
        float((recon.fit(one, "pose", repair=False).joints - truth).norm(dim=-1).mean())
        for one in (seen, seen.replace(std=std))
    ]
    assert errors[1] < 0.7 * errors[0]
