"""What a sensor sees of a surface, how noisy it is, and matches of labelled points."""

import numpy as np
import pytest
import torch

from recon.core.geometry.roughness import depth_noise
from recon.core.geometry.visible import facing, unhidden


def sheet(depth: float, count: int = 20, size: float = 0.4) -> torch.Tensor:
    """Points of a square across the x axis at a distance from the origin, metres."""
    place = torch.linspace(-size, size, count)
    y, z = torch.meshgrid(place, place, indexing="ij")
    return torch.stack((torch.full_like(y, depth), y, z), -1).flatten(0, 1)


def test_what_is_behind_something_is_hidden():
    """A leg behind the other one took its points, as only its normals were looked at."""
    near, far, beside = sheet(2.0), sheet(2.5, size=0.3), sheet(2.5) + torch.tensor([0, 2.0, 0])
    middles = torch.cat((near, far, beside))
    normals = torch.tensor([-1.0, 0.0, 0.0]).expand_as(middles)
    eye = torch.zeros(3)
    front = facing(middles, normals, eye)
    assert front.all()
    seen = unhidden(middles, front, eye, 0.1)
    assert seen[:400].all()
    assert not seen[400:800].any()
    assert seen[800:].all()
    assert unhidden(middles, front, eye, 0.6).all()
    away = facing(middles, -normals, eye)
    assert not unhidden(middles, away, eye, 0.1).any()


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
