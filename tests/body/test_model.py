"""The body: golden skinning, laws of the joints-only and subset paths, the bundled asset."""

import numpy as np
import pytest
import torch

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from tests.conftest import GOLDEN


def golden() -> dict[str, torch.Tensor]:
    with np.load(GOLDEN / "lbs.npz", allow_pickle=False) as file:
        return {key: torch.from_numpy(file[key].astype(np.float64)) for key in file.files}


def golden_motion(g: dict[str, torch.Tensor]) -> Motion:
    return Motion.create(g["trans"][:, None], so3.exp(g["pose_aa"])[:, None], g["betas"], 30.0)


def some_motion(body: BodyModel, clips=2, frames=3) -> Motion:
    return Motion.create(
        torch.randn(clips, frames, 3, dtype=torch.float64),
        so3.exp(0.4 * torch.randn(clips, frames, 22, 3, dtype=torch.float64)),
        torch.randn(clips, body.shape_size, dtype=torch.float64),
        30.0,
    )


def test_joints_and_vertices_equal_golden(toy_body):
    g = golden()
    posed = toy_body.pose(golden_motion(g))
    assert torch.allclose(posed.joints[:, 0], g["joints_exact"], atol=1e-12, rtol=0)
    assert torch.allclose(posed.vertices[:, 0], g["verts_exact_posedirs_zero"], atol=1e-12, rtol=0)


def test_pose_correctives_equal_golden(toy_body):
    g = golden()
    with np.load(GOLDEN / "toy_body.npz", allow_pickle=False) as file:
        directions = torch.from_numpy(file["posedirs_random"].astype(np.float64))
    body = toy_body.replace(pose_directions=directions.unflatten(1, (-1, 3)))
    vertices = body.pose(golden_motion(g)).vertices[:, 0]
    assert torch.allclose(vertices, g["verts_exact_posedirs_random"], atol=1e-12, rtol=0)


def test_a_subset_of_vertices_is_that_part_of_the_mesh(body):
    posed = body.pose(some_motion(body))
    chosen = torch.tensor([5, 0, 6000])
    assert torch.allclose(posed.points(chosen), posed.vertices[..., chosen, :], atol=1e-12)


def test_gradients_of_the_hand_written_chain(toy_body):
    motion = some_motion(toy_body)

    def joints(vector, translation, shape):
        moved = Motion.create(translation, so3.exp(vector), shape, 30.0)
        posed = toy_body.pose(moved)
        return posed.joints, posed.orientations, posed.points(torch.tensor([3, 40]))

    inputs = (so3.log(motion.rotations), motion.translation, motion.shape)
    assert torch.autograd.gradcheck(joints, [i.clone().requires_grad_() for i in inputs])


def test_a_rigid_turn_of_the_root_turns_the_body_about_its_pelvis(body):
    motion = some_motion(body)
    turn = so3.exp(torch.randn(3, dtype=torch.float64))
    roots = torch.cat(
        (turn @ motion.rotations[..., :1, :, :], motion.rotations[..., 1:, :, :]), -3
    )
    a, b = body.pose(motion), body.pose(motion.replace(rotations=roots))
    pelvis = a.joints[..., :1, :]
    assert torch.allclose(b.joints, (a.joints - pelvis) @ turn.T + pelvis, atol=1e-12)
    moved = (a.vertices - pelvis) @ turn.T + pelvis
    assert torch.allclose(b.vertices, moved, atol=1e-6)  # m; weights are stored in float32


def test_fewer_shape_coefficients_are_the_first_ones(body):
    motion = some_motion(body)
    short = motion.replace(shape=motion.shape[..., :4])
    padded = motion.replace(shape=motion.shape * (torch.arange(body.shape_size) < 4))
    assert torch.allclose(body.pose(short).joints, body.pose(padded).joints)
    with pytest.raises(ValueError, match="shape coefficients"):
        body.rest_joints(torch.zeros(body.shape_size + 1, dtype=torch.float64))


def test_the_bundled_body_is_a_closed_surface_of_plausible_people(body):
    trimesh = pytest.importorskip("trimesh")
    people = {"nobody": torch.zeros_like(body.male), "man": body.male, "woman": body.female}
    for name, shape in people.items():
        vertices = body.rest_vertices(shape)
        mesh = trimesh.Trimesh(vertices.numpy(), body.faces.numpy(), process=False)
        assert mesh.is_watertight, name
        assert mesh.euler_number == 2
        height = float(vertices[:, 1].max() - vertices[:, 1].min())
        assert 1.5 < height < 1.95, name  # metres
        assert 40 < 1000 * mesh.volume < 110  # litres
    assert torch.allclose(body.weights.sum(-1), torch.ones(len(body.weights)).double(), atol=1e-6)
    joints = body.rest_joints(people["nobody"])
    assert joints[JOINTS.index("left_wrist"), 0] > 0.5  # the left is +x
    assert joints[JOINTS.index("head"), 1] > joints[JOINTS.index("left_foot"), 1] + 1.2
