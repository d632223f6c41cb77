"""Joints and markers as observations: golden value, laws, clocks, first guesses, offsets."""

import numpy as np
import pytest
import torch

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.residuals import geman_mcclure
from recon.core.scene import Scene
from recon.formats.observations import PositionsFile
from recon.reading.points import positions_of
from tests import laws
from tests.conftest import GOLDEN
from tests.core.test_units import dancer

VERTICES = (0, 9, 17, 30, 44)


def seen_exactly(kind, body, motion):
    posed = body.pose(motion)
    if kind is Joints3D:
        positions, places = posed.joints, tuple(range(22))
    else:
        positions, places = posed.points(torch.tensor(VERTICES)), VERTICES
    visible = torch.ones(positions.shape[:-1], dtype=torch.bool)
    return kind(positions, visible, places, motion.fps, motion.start_time)


@pytest.mark.parametrize("kind", [Joints3D, Markers3D])
def test_energies_keep_their_contract_and_vanish_at_the_truth(kind, toy_body):
    motion = laws.a_motion(toy_body)
    observation = seen_exactly(kind, toy_body, motion)
    laws.check_energy(observation, toy_body, motion, motion)
    away = motion.replace(translation=motion.translation + 0.01)
    points = observation.positions.shape[1] * observation.positions.shape[2]
    expected = 0.5 * points * 3 * 0.01**2
    value = observation(laws.estimate_of(toy_body, away))
    assert torch.allclose(value, torch.full((2,), expected).double(), rtol=1e-9)


@pytest.mark.parametrize("kind", [Joints3D, Markers3D])
def test_what_is_not_visible_counts_nothing(kind, toy_body):
    motion = laws.a_motion(toy_body)
    observation = seen_exactly(kind, toy_body, motion)
    hidden = torch.zeros_like(observation.visible)
    nothing = observation.replace(positions=observation.positions * 0, visible=hidden)
    laws.check_energy(nothing, toy_body, motion, motion)
    every_other = torch.arange(hidden.shape[-1]) % 2 == 0
    partly = observation.replace(visible=every_other.expand_as(hidden))
    spoilt = partly.replace(
        positions=torch.where(partly.visible[..., None], partly.positions, 9.0)
    )
    assert torch.equal(
        partly(laws.estimate_of(toy_body, motion)), spoilt(laws.estimate_of(toy_body, motion))
    )


def test_golden_joints3d(toy_body):
    with np.load(GOLDEN / "losses.npz", allow_pickle=False) as file:
        g = {key: file[key] for key in file.files}
    tensor = {
        k: torch.from_numpy(v.astype(np.float64)) for k, v in g.items() if v.dtype.kind == "f"
    }
    motion = laws.Motion.create(
        tensor["camera_trans"], so3.exp(tensor["camera_pose"]), tensor["betas"], 30.0
    )
    observed = tensor["obs_joints3d"].reshape(2, 8, 22, 3)
    visible = observed.isfinite().all(-1)
    observation = Joints3D(
        observed.where(visible[..., None], 0.0), visible, tuple(range(22)), 30.0
    )
    value = observation(laws.estimate_of(toy_body, motion)).sum().item()
    assert value == pytest.approx(float(g["value_joints3d"]), rel=1e-6)


def test_another_clock_is_met_by_interpolation(toy_body):
    motion = laws.a_motion(toy_body, frames=31)
    fine = laws.a_motion(toy_body, frames=121, fps=120.0)
    observation = seen_exactly(Joints3D, toy_body, fine.window(10, 100))
    misfit = observation(laws.estimate_of(toy_body, motion))
    assert misfit.shape == (2,)
    per_point = (2 * misfit / (90 * 22 * 30 / 120)).sqrt()
    assert (per_point < 5e-3).all()  # metres: curvature between 30 Hz frames
    early = observation(laws.estimate_of(toy_body, motion.window(0, 15)))
    assert (early < misfit + 1e-12).all()


def test_moments_outside_the_motion_are_left_out(toy_body):
    motion = laws.a_motion(toy_body, frames=6)
    elsewhere = seen_exactly(Joints3D, toy_body, motion).replace(start_time=100.0)
    value = elsewhere(laws.estimate_of(toy_body, motion))
    assert torch.equal(value, torch.zeros(2).double())


@pytest.mark.parametrize("kind", [Joints3D, Markers3D])
def test_windows_hold_what_was_seen_then_and_nothing_where_nothing_was(kind, toy_body):
    motion = laws.a_motion(toy_body, frames=30)
    observation = seen_exactly(kind, toy_body, motion.replace(start_time=2.0))
    inside = observation.window(2.09, 2.5)  # frames 3 to 15
    assert inside.start_time == pytest.approx(2.1)
    assert torch.equal(inside.positions, observation.positions[:, 3:16])
    assert inside.visible.all()
    early = observation.window(1.9, 2.1)
    assert early.start_time == pytest.approx(1.9)
    assert early.visible.shape[1] == 7
    assert not early.visible[:, :3].any()
    assert early.positions[:, :3].abs().max() == 0
    assert torch.equal(early.positions[:, 3:], observation.positions[:, :4])
    away = motion.replace(start_time=2.0, translation=motion.translation + 0.01)
    estimate = laws.estimate_of(toy_body, away)
    parts = [observation.window(a, b)(estimate) for a, b in ((1.0, 2.41), (2.42, 9.0))]
    assert torch.allclose(sum(parts), observation(estimate))


@pytest.mark.parametrize("kind", [Joints3D, Markers3D])
def test_the_first_guess_finds_a_rigid_placement(kind, body):
    motion = laws.a_motion(body, clips=1, frames=3)
    rest = torch.eye(3).double().expand(1, 3, 21, 3, 3)
    stiff = motion.replace(
        rotations=torch.cat((motion.rotations[:, :, :1], rest), 2), shape=motion.shape * 0
    )
    posed = body.pose(stiff)
    vertices = (6, 400, 900, 1500, 2200, 3000, 5000, 6000)
    positions = posed.joints if kind is Joints3D else posed.points(torch.tensor(vertices))
    places = tuple(range(22)) if kind is Joints3D else vertices
    visible = torch.ones(positions.shape[:-1], dtype=torch.bool)
    visible[:, 1] = False  # a frame without anything takes its neighbour's placement
    start = kind(positions, visible, places, 30.0).start(body)
    assert so3.geodesic_angle(start.rotations[0, 0, 0], stiff.rotations[0, 0, 0]) < 1e-5
    assert torch.allclose(start.translation[0, [0, 2]], stiff.translation[0, [0, 2]], atol=1e-6)
    assert start.translation.isfinite().all()
    assert torch.allclose(start.translation[0, 1], start.translation[0, 0])


def test_offsets_move_points_with_their_bones(toy_body):
    motion = laws.a_motion(toy_body)
    observation = seen_exactly(Joints3D, toy_body, motion).replace(offset_rows=(1, 23))
    scene = Scene(torch.zeros(2, 23, 3).double())
    scene.offsets[:, 1 + 5] = torch.tensor([0.0, 0.03, 0.04]).double()
    predicted = observation.predicted(laws.estimate_of(toy_body, motion, scene))
    moved = (predicted - toy_body.pose(motion).joints).norm(dim=-1)
    assert torch.allclose(moved[..., 5], torch.full((2, 6), 0.05).double())
    assert moved[..., :5].max() == 0


def test_a_robust_kernel_bounds_a_wild_point(toy_body):
    motion = laws.a_motion(toy_body)
    observation = seen_exactly(Joints3D, toy_body, motion)
    wild = observation.positions.clone()
    wild[:, 2, 3] += 50.0
    robust = observation.replace(positions=wild, kernel=lambda e: geman_mcclure(e, 0.1))
    assert (robust(laws.estimate_of(toy_body, motion)) <= 0.5 * 0.1**2).all()


def test_a_file_of_a_dancer_with_hidden_legs_is_believed():
    """It was refused ("says z is up, but x ..."): a raised foot was all that was seen of legs."""
    names, positions, visible = dancer(raised=True)
    seen = np.where(visible[..., None], positions, 0)
    file = PositionsFile("joints3d", seen, visible, tuple(names), 30.0)
    found = positions_of(file, "dancer.npz", BodyModel.load())
    assert torch.equal(found.positions[0], torch.from_numpy(seen).float())
