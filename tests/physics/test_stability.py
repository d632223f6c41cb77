"""Base of support and distances to it."""

import pytest
import torch

from recon.physics.zmp import (
    base_of_support,
    can_carry_weight,
    distances_to_support,
    signed_distance,
)

SQUARE = torch.tensor(
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5], [0.5, 0.0]]
).double()


def at(*point: float) -> torch.Tensor:
    return torch.tensor(point, dtype=torch.float64)


def test_distances_to_a_square() -> None:
    hull = base_of_support(SQUARE)
    assert hull is not None
    assert len(hull) == 4
    inside = signed_distance(torch.stack((at(0.5, 0.5), at(0.9, 0.5), at(1.0, 0.5))), hull)
    assert inside.tolist() == pytest.approx([-0.5, -0.1, 0.0], abs=1e-12)
    outside = signed_distance(torch.stack((at(1.3, 1.4), at(-0.2, 0.5))), hull)
    assert outside.tolist() == pytest.approx([0.5, 0.2], abs=1e-12)


def test_no_base_without_area() -> None:
    assert base_of_support(SQUARE[:2]) is None
    assert base_of_support(torch.stack((at(0, 0), at(1, 1), at(2, 2), at(3, 3)))) is None


def test_low_and_slow_skin_supports_at_any_rate() -> None:
    for fps in (20.0, 100.0):
        along = torch.arange(4, dtype=torch.float64)[:, None] / fps * at(0.39, 0.41, 0.0)
        vertices = torch.stack((along, torch.zeros_like(along), torch.zeros_like(along)), -1)
        vertices[..., 2, 2] = 0.051
        assert can_carry_weight(vertices, fps).tolist() == [[True, False, False]] * 4
    assert can_carry_weight(vertices[:1], 20.0).tolist() == [[True, True, False]]


def test_every_frame_has_its_own_base() -> None:
    points = torch.cat((SQUARE, torch.zeros(6, 1).double()), -1).repeat(2, 1, 1)
    standing = torch.ones(2, 6, dtype=torch.bool)
    standing[1, 2:] = False
    asked = torch.stack((at(0.5, 0.5), at(3.0, 0.5))).repeat(2, 1, 1)
    distances, exists = distances_to_support(asked, points, standing)
    assert distances.tolist() == [pytest.approx([-0.5, 2.0]), [0.0, 0.0]]
    assert exists.tolist() == [True, False]
