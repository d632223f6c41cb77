"""How noisy what a sensor sees of a surface is, and matches of labelled points."""

import numpy as np
import pytest
import torch

from recon.core.nearest import nearest_alike
from recon.core.planes import depth_noise


def test_points_take_the_nearest_of_their_kind():
    """Points of one leg held the other one, where that was nearer."""
    g = torch.Generator().manual_seed(0)
    points, surface = (torch.randn(20, 30, 3, generator=g) for _ in range(2))
    kinds, of_surface = torch.rand(20, 30, 4, generator=g), torch.rand(30, 4, generator=g)
    present = torch.rand(20, 30, generator=g) < 0.8
    allowed = torch.rand(20, 30, generator=g) < 0.5
    allowed[3] = False  # then all are
    found = nearest_alike(points, present, kinds, surface, allowed, of_surface)
    cost = torch.cdist(points, surface).square() + kinds @ of_surface.mT
    open_ = allowed.clone()
    open_[3] = True
    expected = cost.masked_fill(~open_[:, None], torch.inf).argmin(-1)
    assert torch.equal(found, torch.where(present, expected, 0))
    found = nearest_alike(points, present & False, kinds, surface, allowed, of_surface)
    assert (found == 0).all(), "a window of a recording in which nothing was seen"


@pytest.mark.parametrize("deviation", [0.01, 0.03, 0.07])
def test_the_noise_of_depths_is_told_without_a_model(deviation):
    """The noise of clouds was a constant centimetre: at 6 m a sensor errs by 7 cm."""
    random = np.random.default_rng(0)
    rays = random.normal(size=(6, 400, 3)) * [0.0, 0.1, 0.2] + [1.0, 0.0, 0.0]
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    depth = 3.0 + 0.8 * rays[..., 1] + deviation * random.standard_normal(rays.shape[:2])
    depth[:, ::9] += 0.5  # flying pixels
    present = np.ones(depth.shape, bool)
    present[2] = False
    eye = np.tile([1.0, -2.0, 0.5], (6, 1))
    found = depth_noise(rays * depth[..., None] + eye[:, None], present, eye)
    assert found == pytest.approx(np.full(6, deviation), rel=0.25)
    assert (depth_noise(rays, present & False, eye) == 0).all()
