"""A motion on another shape: soles keep to the floor, feet do not slip, the place is kept."""

from importlib import resources

import pytest
import torch

from recon.body.motion_files import with_shape
from recon.core.skeleton import TOES
from recon.formats.motions import load_motion


@pytest.fixture(scope="module")
def walk(body):
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        return load_motion(path).motion.window(0, 60).to(dtype=torch.float64)


def lowest(body, motion):
    return body.pose(motion).vertices[..., 2].amin(-1)


def test_the_same_shape_is_the_same_motion(body, walk):
    same = with_shape(walk, body, walk.shape)
    assert torch.allclose(same.translation, walk.translation, atol=1e-12)


@pytest.mark.parametrize("size", [-2.0, 2.0])
def test_soles_stay_on_the_floor(body, walk, size):
    """Heights of the lowest point change by millimetres though legs change by centimetres."""
    shape = size * (body.male - body.female) + walk.shape.new_zeros(body.shape_size)
    moved = with_shape(walk, body, shape)
    pelvis = body.pose(moved).joints[:, 0] - body.pose(walk).joints[:, 0]
    assert pelvis[:, 2].abs().mean() > 0.01
    assert (lowest(body, moved) - lowest(body, walk)).abs().max() < 0.015
    assert torch.equal(moved.rotations, walk.rotations)
    # it starts where it started, and steps are longer as legs are
    assert pelvis[0, :2].abs().max() < 1e-12
    joints = [body.pose(m).joints for m in (walk, moved)]
    reach = [(j[-1, 0] - j[0, 0])[:2].norm() for j in joints]
    assert (reach[1] > reach[0]) == (size > 0)
    slip = [j[:, list(TOES)].diff(dim=0).norm(dim=-1).amin(-1).mean() for j in joints]
    assert slip[1] < slip[0] + 0.002


def test_a_batch_is_its_clips(body, walk):
    shapes = 0.5 * torch.randn(2, body.shape_size, dtype=torch.float64)
    both = walk.map(lambda tensor: torch.stack((tensor, tensor)))
    moved = with_shape(both, body, shapes)
    alone = with_shape(walk, body, shapes[1])
    assert torch.allclose(moved.translation[1], alone.translation, atol=1e-12)
