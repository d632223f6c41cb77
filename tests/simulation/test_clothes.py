"""Clothes: a few millimetres to centimetres outside the skin, smooth, none on hands and feet."""

import torch

from recon.body.landmarks import landmark
from recon.core.skeleton import joint_index
from recon.simulation.scenery import clothed, clothing_offsets, random_field


def carried_by(body, *names):
    """Vertices that move with some joints alone."""
    return body.weights[:, [joint_index(name) for name in names]].sum(1) > 0.95


def test_clothes_are_where_people_wear_them(body):
    for seed in range(4):
        away = clothing_offsets(body, seed)
        assert 0.003 < away.mean() < 0.012
        loose = away[carried_by(body, "pelvis", "spine1", "left_hip", "right_hip")]
        assert 0.003 < loose.median() < 0.015
        assert 0.01 < loose.quantile(0.98) < 0.045
        assert (away < -0.001).double().mean() < 0.03
        bare = carried_by(body, "left_wrist", "right_wrist", "left_foot", "right_foot", "head")
        assert away[bare].abs().max() < 0.002
        assert away[landmark("nose")].abs() < 0.001


def test_only_the_surface_changes_and_only_outwards(body):
    dressed = clothed(body, 3)
    assert dressed.name != body.name
    assert torch.equal(dressed.joint_template, body.joint_template)
    moved = dressed.template - body.template
    assert torch.allclose(moved.norm(dim=-1), clothing_offsets(body, 3).abs(), atol=1e-12)
    belly, back = landmark("navel"), landmark("t10")
    assert moved[belly, 2] > 0.0005  # the body faces +z
    assert moved[back, 2] < -0.0005
    assert torch.equal(clothed(body, 3).template, dressed.template)
    assert not torch.allclose(clothed(body, 4).template, dressed.template, atol=1e-3)


def test_a_random_field_is_smooth_over_its_length():
    line = torch.linspace(0, 40, 4001, dtype=torch.float64)
    points = torch.stack((line, 0 * line, 0 * line), -1)
    field = random_field(points, 0.2, torch.Generator().manual_seed(0))
    assert abs(field.std() - 1) < 0.15
    near = (field[20:] * field[:-20]).mean() / field.square().mean()
    assert abs(near - torch.tensor(-0.5).exp()) < 0.1  # exp(-d² / 2 l²) at d = l
    assert field.diff().abs().max() < 0.25
