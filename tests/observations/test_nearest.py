"""Nearest neighbours against all distances, and what happens when nothing is allowed."""

import pytest
import torch

from recon.core.nearest import _nearest_by_distances, nearest  # pyright: ignore[reportPrivateUsage]


@pytest.fixture
def scattered():
    g = torch.Generator().manual_seed(1)
    points = torch.randn(2, 3, 40, 3, generator=g, dtype=torch.float64)
    surface = torch.randn(2, 3, 70, 3, generator=g, dtype=torch.float64)
    present = torch.rand(2, 3, 40, generator=g) < 0.7
    allowed = torch.rand(2, 3, 70, generator=g) < 0.5
    allowed[1, 2] = False
    present[0, 1] = False
    return points, present, surface, allowed


def test_both_searches_find_the_nearest_allowed_point(scattered):
    points, present, surface, allowed = scattered
    distance = (points[..., :, None, :] - surface[..., None, :, :]).norm(dim=-1)
    open_ = allowed | ~allowed.any(-1, keepdim=True)
    expected = distance.where(open_[..., None, :], torch.inf).argmin(-1).where(present, 0)
    assert torch.equal(nearest(points, present, surface, allowed), expected)
    rows = _nearest_by_distances(*(t.flatten(0, 1) for t in (points, present, surface, open_)))
    assert torch.equal(rows.unflatten(0, (2, 3)), expected)


def test_a_search_of_no_point_finds_nothing(scattered):
    points, present, surface, allowed = scattered
    found = nearest(points[..., :0, :], present[..., :0], surface, allowed)
    assert found.shape == (2, 3, 0)
