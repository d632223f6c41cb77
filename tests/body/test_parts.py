"""Volumes of closed surfaces, of the ten parts, and their sum."""

import pytest
import torch
import trimesh

from recon.body.parts import PARTS, Parts
from recon.body.volumes import Openings, part_volumes

MIRRORED = [0, 1, 3, 2, 5, 4, 7, 6, 9, 8]


def ellipsoid() -> tuple[torch.Tensor, torch.Tensor, float]:
    """Vertices and faces of a fine ellipsoid away from the origin, and its exact volume."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    axes = torch.tensor([0.1, 0.2, 0.4], dtype=torch.float64)
    vertices = torch.from_numpy(ball.vertices.copy()) * axes + 3.0
    return vertices, torch.from_numpy(ball.faces.copy()), 4 / 3 * torch.pi * float(axes.prod())


def test_an_ellipsoid_has_its_volume() -> None:
    vertices, faces, exact = ellipsoid()
    whole = Parts.of_labels(vertices, faces, torch.zeros(len(vertices), dtype=torch.long))
    volumes = part_volumes(vertices, whole)
    assert volumes[0].item() == pytest.approx(exact, rel=5e-3)
    assert (volumes[1:] == 0).all()
    assert len(Openings.of(whole).edges) == 0


def test_halves_are_closed_and_thirds_too() -> None:
    vertices, faces, exact = ellipsoid()
    halves = Parts.of_labels(vertices, faces, (vertices[:, 2] > 3.0).long())
    assert part_volumes(vertices, halves)[:2].tolist() == pytest.approx([exact / 2] * 2, rel=0.05)
    # the middle of three has two loops: each needs its own fan
    middle = (vertices[:, 2] > 2.9).long() + (vertices[:, 2] > 3.1).long()
    thirds = Parts.of_labels(vertices, faces, middle)
    u = 0.25
    slab = exact * 3 / 4 * (2 * u - 2 * u**3 / 3)
    assert part_volumes(vertices, thirds)[1].item() == pytest.approx(slab, rel=0.05)
    assert part_volumes(vertices, thirds).sum().item() == pytest.approx(exact, rel=5e-3)


def test_parts_of_the_body_are_symmetric_and_add_up(body) -> None:
    volumes = part_volumes(body.template, Parts.of(body))
    assert torch.allclose(volumes, volumes[MIRRORED], rtol=1e-4)
    a, b, c = body.template[body.faces].unbind(-2)
    whole = (a * torch.linalg.cross(b, c)).sum() / 6
    assert volumes.sum().item() == pytest.approx(whole.item(), rel=1e-10)
    litres = dict(zip(PARTS, (1000 * volumes).tolist(), strict=True))
    assert 3.5 < litres["head"] < 5.5
    assert 0.4 < litres["torso"] / sum(litres.values()) < 0.6
    assert litres["left_thigh"] > litres["left_lower_leg"] > litres["left_upper_arm"]


def test_volumes_follow_a_batch_of_shapes_and_do_not_move(body) -> None:
    rest = torch.stack((body.template, 2 * body.template + 5.0))
    one, eight = part_volumes(rest, Parts.of(body))
    assert torch.allclose(eight, 8 * one, rtol=1e-9)


def test_volumes_have_a_gradient(body) -> None:
    scale = torch.ones((), dtype=torch.float64, requires_grad=True)
    volumes = part_volumes(body.template * scale, Parts.of(body))
    (slope,) = torch.autograd.grad(volumes.sum(), scale)
    assert slope.item() == pytest.approx(3 * volumes.sum().item(), rel=1e-8)


def test_a_body_without_surface_is_refused(toy_body) -> None:
    with pytest.raises(ValueError, match="masses need a body whose mesh covers all ten parts"):
        Parts.of(toy_body)
