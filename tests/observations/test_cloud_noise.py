"""How much the moments of a cloud count: by their noise, by their points."""

from dataclasses import replace

import pytest
import torch

from observations.depth import CLOUD_NOISE, CLOUD_WORTH, PointCloud
from observations.surfels import Surfels, fixed_scale_kernel
from recon.core.camera import depth_camera
from recon.core.errors import ObservationError
from recon.reading.clouds import cloud_of
from recon.simulation.depth import DepthSensor, depth_points
from recon.simulation.points import Corruption
from tests import laws
from tests.filmed import bundled, walk


def noisy(body, motion, spread, **fields):
    g = torch.Generator().manual_seed(3)
    points = body.pose(motion).vertices[..., ::2, :]
    points = points + spread * torch.randn(points.shape, generator=g, dtype=points.dtype)
    present = torch.ones(points.shape[:-1], dtype=torch.bool)
    return PointCloud(points, present, Surfels.of(body), motion.fps, **fields)


def test_moments_of_a_noisy_sensor_count_less(toy_body):
    """A person 6 m away, seen with 7 cm of noise, was followed as one at 2 m is."""
    motion = laws.a_motion(toy_body)
    cloud = noisy(toy_body, motion, 0.02, kernel=fixed_scale_kernel)
    estimate = laws.estimate_of(toy_body, motion)
    moments = cloud.present.shape[:-1]
    alike = cloud.replace(std=torch.zeros(moments))
    assert torch.allclose(alike(estimate), cloud(estimate))
    far = cloud.replace(std=torch.full(moments, 5 * CLOUD_NOISE))
    count = max(cloud.points.shape[-2], CLOUD_WORTH)
    # the kernel lets through more of what is known to be noisy, so energies are compared where
    # distances, here from the middles of discs, are small
    near = noisy(toy_body, motion, 3e-3, kernel=fixed_scale_kernel)
    points = replace(near.surfels, radii=near.surfels.radii * 0)
    near = near.replace(surfels=points)
    share = near.replace(std=far.std)(estimate) / near(estimate)
    assert share.numpy() == pytest.approx(1 / (1 + 25 * CLOUD_WORTH / count), rel=0.01)


def test_noise_goes_with_its_moments(toy_body):
    motion = laws.a_motion(toy_body, frames=31)
    moments = (2, 31)
    std = torch.linspace(0.01, 0.02, 31).expand(moments)
    cloud = noisy(toy_body, motion, 0.01, std=std)
    every = [cloud.window(0.2, 0.5), cloud.coarse(toy_body), cloud.with_at_most_points(3)]
    part, coarse, thin = (one.std for one in every)
    assert part is not None
    assert coarse is not None
    assert thin is not None
    assert torch.allclose(part, std[:, 6:16].double())
    assert coarse.shape == (2, 16)
    assert thin.shape == moments
    held = cloud.matched(laws.estimate_of(toy_body, motion))
    assert torch.allclose(
        held(laws.estimate_of(toy_body, motion)), cloud(laws.estimate_of(toy_body, motion))
    )
    with pytest.raises(ObservationError, match="expected one std"):
        cloud.replace(std=std[:, 1:])


@pytest.mark.parametrize("constant", [0.002, 0.04])
def test_a_loaded_cloud_knows_its_noise(constant):
    motion, body = walk(4), bundled()
    middle = motion.translation[0] + torch.tensor([0.0, 0.0, 0.9])
    camera = depth_camera().placed(middle + torch.tensor([2.5, 0.0, 0.3]), middle)
    sensor = DepthSensor(constant=constant, quadratic=0.0)
    file = depth_points(motion, body, camera, Corruption(), 0, sensor=sensor)
    std = cloud_of(file, body).cloud.std
    assert std is not None
    assert std.shape == (1, 4)
    # curved limbs among half a thousand points add some millimetres
    expected = max(constant, 0.0055)
    assert std[0].numpy() == pytest.approx(expected, rel=0.4)
