"""Frames with ties: the minimum, from near and far, and what is promised on the way."""

from dataclasses import dataclass, replace
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from recon.core.struct import TensorStruct
from recon.ingest.tied_frames import LevenbergMarquardt, TiedFrames, minimise_frames

TIGHT = LevenbergMarquardt(tolerance=1e-9, floor=1e-3, inner_tolerance=1e-3, inner_iterations=30)


@dataclass(frozen=True)
class _Points(TensorStruct):
    """Two variables of every frame."""

    x: Tensor


@dataclass(frozen=True)
class _Bent(TiedFrames[_Points]):
    """½ |(10 (b - a²), 1 - a) - data|² of every frame, Rosenbrock's valley, and springs."""

    data: Tensor
    linked: Tensor
    spring: float
    kinds: Tensor

    @property
    def tie_stiffness(self) -> Tensor:
        return self.data.new_full((2,), self.spring)

    def residuals(self, x: Tensor) -> Tensor:
        a, b = x.unbind(-1)
        return torch.stack((10 * (b - a.square()), 1 - a), -1)

    def jacobian(self, x: Tensor) -> Tensor:
        a = x[:, 0]
        rows = (-20 * a, torch.full_like(a, 10.0), -torch.ones_like(a), torch.zeros_like(a))
        return torch.stack(rows, -1).unflatten(-1, (2, 2))

    def energies_and_gradients(self, state: _Points, rows: Tensor) -> tuple[Tensor, Tensor]:
        x = state.x[rows]
        away = self.residuals(x) - self.data[rows]
        return 0.5 * away.square().sum(-1), (self.jacobian(x).mT @ away[..., None])[..., 0]

    def curvature(self, state: _Points, rows: Tensor) -> Tensor:
        jacobian = self.jacobian(state.x[rows])
        return jacobian.mT @ jacobian

    def can_share_hessian(self, some: Tensor, others: Tensor) -> Tensor:
        return self.kinds[some] == self.kinds[others]

    def tie_energies(self, state: _Points) -> tuple[Tensor, Tensor]:
        step = state.x.diff(dim=0) * self.linked[:, None]
        ends = torch.nn.functional.pad(self.spring * step, (0, 0, 1, 1))
        return 0.5 * self.spring * step.square().sum(-1), ends[:-1] - ends[1:]

    def moved(self, state: _Points, rows: Tensor, steps: Tensor) -> _Points:
        return _Points(state.x.index_add(0, rows, steps))


@pytest.fixture
def bent() -> _Bent:
    generator = torch.Generator().manual_seed(0)
    data = 0.3 * torch.randn(12, 2, generator=generator, dtype=torch.float64)
    linked = torch.arange(11) != 5
    return _Bent(data, linked, 0.4, torch.arange(12) % 5 == 0)


def total(bent: _Bent, x: Tensor) -> Tensor:
    value, _ = bent.energies_and_gradients(_Points(x), torch.arange(len(x)))
    between, _ = bent.tie_energies(_Points(x))
    return value.sum() + between.sum()


def start() -> _Points:
    return _Points(torch.tensor([[-1.2, 1.0]], dtype=torch.float64).expand(12, 2).clone())


def slope(bent: _Bent, x: Tensor) -> Tensor:
    x = x.clone().requires_grad_()
    return torch.autograd.grad(total(bent, x), x)[0]


@pytest.mark.parametrize("stride", [1, 4])
def test_the_minimum_is_reached(bent: _Bent, stride: int) -> None:
    found = minimise_frames(bent, start(), replace(TIGHT, stride=stride, max_iterations=200))
    assert found.converged.all()
    assert slope(bent, found.state.x).abs().max() < 1e-3
    assert found.total == pytest.approx(float(total(bent, found.state.x)))


def test_the_energy_never_rises(bent: _Bent) -> None:
    energies = [
        minimise_frames(bent, start(), replace(TIGHT, max_iterations=k)).total for k in range(30)
    ]
    assert all(b <= a * (1 + 1e-6) for a, b in pairwise(energies))
    assert energies[-1] < 0.1 * energies[0]


def test_frames_that_do_not_move_hold_the_others(bent: _Bent) -> None:
    rows = torch.tensor([3, 4, 8])
    found = minimise_frames(bent, start(), replace(TIGHT, max_iterations=200), rows)
    still = torch.ones(12, dtype=torch.bool)
    still[rows] = False
    assert torch.equal(found.state.x[still], start().x[still])
    assert slope(bent, found.state.x)[rows].abs().max() < 1e-3


def test_shared_curvatures_are_fewer(bent: _Bent) -> None:
    counts = [
        minimise_frames(bent, start(), replace(TIGHT, max_iterations=0, stride=k)).curvatures
        for k in (1, 6)
    ]
    # two runs of six, and the three frames of another kind: 0, 5 and 10
    assert counts == [12, 5]


def test_a_limit_ends_without_convergence(bent: _Bent) -> None:
    found = minimise_frames(bent, start(), replace(TIGHT, max_iterations=2))
    assert found.iterations == 2
    assert not found.converged.any()
