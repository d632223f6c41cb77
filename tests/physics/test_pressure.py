"""Centre of pressure: of a sole, of two feet, far from the ground."""

import torch

from recon.physics.zmp import centre_of_pressure, pressure

SOLE = torch.cartesian_prod(
    torch.linspace(-0.05, 0.05, 5), torch.linspace(-0.12, 0.12, 9), torch.zeros(1)
).double()


def feet(raised: float) -> torch.Tensor:
    """Points of two flat soles 20 cm apart, the right one raised."""
    aside = torch.tensor([0.1, 0.0, 0.0], dtype=torch.float64)
    up = torch.tensor([0.0, 0.0, raised], dtype=torch.float64)
    return torch.cat((SOLE - aside, SOLE + aside + up))


def test_a_flat_sole_presses_at_its_centroid() -> None:
    areas = torch.ones(len(SOLE), dtype=torch.float64)
    moved = SOLE + torch.tensor([2.0, -1.0, 0.0], dtype=torch.float64)
    centre = centre_of_pressure(moved, areas)
    assert torch.allclose(centre, torch.tensor([2.0, -1.0], dtype=torch.float64), atol=1e-12)


def test_raising_a_foot_by_10_cm_moves_the_pressure_to_the_other() -> None:
    areas = torch.ones(2 * len(SOLE), dtype=torch.float64)
    assert centre_of_pressure(feet(0.0), areas).abs().max() < 1e-12
    assert centre_of_pressure(feet(0.1), areas)[0] < -0.09
    assert centre_of_pressure(feet(-0.02), areas)[0] > 0.04  # what sinks presses more


def test_skin_counts_by_its_area() -> None:
    areas = torch.cat((torch.full((len(SOLE),), 3.0), torch.ones(len(SOLE)))).double()
    assert torch.allclose(
        centre_of_pressure(feet(0.0), areas), torch.tensor([-0.05, 0.0], dtype=torch.float64)
    )


def test_pressure_is_continuous_at_the_ground_and_finite_far_from_it() -> None:
    heights = torch.tensor([-0.01, -1e-9, 0.0, 1e-9, 0.05], dtype=torch.float64)
    expected = torch.tensor([2.0, 1.0, 1.0, 1.0, 0.2231301601], dtype=torch.float64)
    assert torch.allclose(pressure(heights), expected, atol=1e-6)
    high = (feet(0.0) + 100.0).requires_grad_()
    centre = centre_of_pressure(high, torch.ones(len(high), dtype=torch.float64))
    (slope,) = torch.autograd.grad(centre.sum(), high)
    assert centre.isfinite().all()
    assert slope.isfinite().all()
