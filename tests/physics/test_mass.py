"""Mass and its motion: bones against vertices, point masses against mechanics."""

import pytest
import torch

from recon.body.parts import PARTS, Parts, centre_of_mass, vertex_masses_of_segments
from recon.body.volumes import part_volumes
from recon.physics import dynamics
from recon.physics.dynamics import body_dynamics, second_differences
from tests import laws
from tests.physics.point_masses import points_dynamics
from tests.standing_body import path, standing, times


def test_bones_move_mass_as_all_vertices_do(body) -> None:
    motion = laws.a_motion(body, frames=5, fps=20.0)
    posed = body.pose(motion)
    masses = 70 * dynamics.vertex_masses(body, motion.shape)
    ours, theirs = (
        body_dynamics(posed, masses, 20.0),
        points_dynamics(posed.vertices, masses, 20.0),
    )
    for name, value in ours.tensors().items():
        assert torch.allclose(value, theirs.tensors()[name], rtol=1e-7, atol=1e-7), name
    centre = (masses[:, None, :, None] * posed.vertices).sum(-2) / masses.sum(-1)[:, None, None]
    assert torch.allclose(centre_of_mass(posed, masses), centre, atol=1e-10)


def test_a_spinning_up_rod_has_the_torque_of_its_inertia() -> None:
    t, rate = times(0.1, 1000.0), 3.0
    angle = rate * t.square() / 2
    end = torch.stack((angle.cos(), torch.zeros_like(t), angle.sin()), -1)
    moving = points_dynamics(
        torch.stack((end, -end), 1), torch.tensor([2.0, 2.0]).double(), 1000.0
    )
    # from x to z is a negative turn about y; I = 4 kg m²
    expected = torch.tensor([0.0, -4 * rate, 0.0], dtype=torch.float64)
    assert torch.allclose(moving.spin, expected.expand_as(moving.spin), rtol=1e-2, atol=1e-6)
    assert moving.centre.abs().max() < 1e-12


def test_second_differences_span_a_twentieth_of_a_second_at_any_rate() -> None:
    for fps in (20.0, 60.0, 120.0):
        t = times(0.5, fps)
        bends = second_differences((3 * t.square())[:, None, None], fps)
        assert torch.allclose(bends, torch.full_like(bends, 6.0), rtol=1e-9)
        assert len(bends) == len(t) - 2 * dynamics.difference_step(fps)
    assert dynamics.difference_step(120.0) == 6
    assert dynamics.difference_step(10.0) == 1


def test_clips_too_short_for_accelerations_have_none() -> None:
    for frames in (0, 1, 2):
        assert second_differences(torch.zeros(2, frames, 4, 3), 20.0).shape == (2, 0, 4, 3)
        assert dynamics.inner_frames(torch.zeros(2, frames, 4, 3), 20.0).shape == (2, 0, 4, 3)


def test_masses_are_shares_by_part_and_published_ones_too(body) -> None:
    parts = Parts.of(body)
    rest = body.rest_vertices(torch.zeros(body.shape_size, dtype=torch.float64))
    volumes = part_volumes(rest, parts)
    ours = dynamics.vertex_masses(body, torch.zeros(body.shape_size, dtype=torch.float64))
    published = dynamics.vertex_masses_as_published(rest, parts)
    for masses in (ours, published):
        of_part = masses.new_zeros(len(PARTS)).index_add(0, parts.of_vertex, masses)
        assert torch.allclose(of_part, volumes / volumes.sum(), rtol=1e-9)
    assert published[parts.of_vertex == 0].std() < 1e-15 < ours[parts.of_vertex == 0].std()
    segments = vertex_masses_of_segments(body)
    assert segments[parts.of_vertex == 6].sum().item() == pytest.approx(0.1447, abs=1e-4)
    assert segments.sum().item() == pytest.approx(1, abs=1e-3)


def test_the_centre_of_a_standing_body_is_at_its_pelvis(body) -> None:
    motion = standing(body, path(like=times(0.1)))
    posed = body.pose(motion)
    centre = centre_of_mass(posed, dynamics.vertex_masses(body, motion.shape))[0]
    assert abs(centre[0] - posed.joints[0, 0, 0]) < 1e-3  # metres
    height = (posed.vertices[0, :, 2].amax()).item()
    assert 0.52 < centre[2].item() / height < 0.62
