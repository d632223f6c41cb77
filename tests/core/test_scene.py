"""An unknown ground: its frame, what it leaves alone, and variables carried to its world."""

from dataclasses import dataclass
from typing import Any

import pytest
import torch

from observations.correspondences import BodyPoints
from observations.keypoints2d import Keypoints2D
from priors.pose.prior import PosePrior
from recon.core import rotations as so3
from recon.core.camera import full_hd_camera, transform
from recon.core.motion import Motion
from recon.core.scene import GROUND, TILT, ZOOM, Scene, UnknownGround, UnknownLens
from recon.core.struct import TensorStruct
from recon.method.free import FreeMotion
from recon.method.priors import Prior
from recon.method.protocols import Decoded, Estimate
from recon.method.stages import Stage
from recon.method.terms import Term
from tests import laws


def a_ground(clips: int = 2) -> UnknownGround:
    """Turned by a few degrees and lifted by half a metre."""
    g = torch.Generator().manual_seed(4)
    pivot = torch.randn(clips, 3, generator=g).double() * torch.tensor([1.0, 1.0, 0.0])
    tilt = 0.5 * torch.randn(clips, 2, generator=g).double()
    return UnknownGround(tilt, torch.full((clips,), 0.5).double(), pivot)


def scene_with(ground: UnknownGround) -> Scene:
    return Scene.create(len(ground.lift), like=ground.lift).replace(ground=ground)


def filmed(body, motion) -> Keypoints2D:
    """Pixels of the motion in the recording's frame, from a camera of no importance."""
    place, target = motion.translation.new_tensor([[4.0, 0.5, 1.5], [0.0, 0.0, 1.0]])
    one = full_hd_camera().to(dtype=torch.float64).placed(place, target)
    camera = one.map(lambda t: t.expand(len(motion.translation), 1, *t.shape))
    points = BodyPoints.of_layout("smpl22", body)
    pixels = camera.project(points.of(body.pose(motion))).pixels
    seen = torch.ones_like(pixels[..., 0])
    return Keypoints2D(pixels, seen, points, camera, motion.fps, ground_known=False)


def test_the_frame_is_rigid_and_turns_about_the_pivot_by_the_tilt():
    ground = a_ground()
    T = ground.T_world_recording
    turn = T[:, :3, :3]
    torch.testing.assert_close(turn @ turn.mT, torch.eye(3).double().expand(2, 3, 3))
    angle = so3.log(turn).norm(dim=-1)
    torch.testing.assert_close(angle, TILT * ground.tilt.norm(dim=-1))  # radians
    pivot = transform(T, ground.pivot[:, None])[:, 0]
    up = torch.tensor([0.0, 0.0, 0.5]).double()
    torch.testing.assert_close(pivot, ground.pivot + up)


def test_the_start_is_the_recording_itself_even_far_away():
    pivot = torch.tensor([[30.0, -20.0, 0.0]])
    torch.testing.assert_close(UnknownGround.create(pivot).T_world_recording[0], torch.eye(4))


def test_the_plane_is_the_worlds_ground_seen_from_the_recording():
    ground = a_ground()
    points = torch.randn(2, 7, 3).double()
    world = transform(ground.T_world_recording, points)
    torch.testing.assert_close(ground.plane.heights(points), world[..., 2])
    torch.testing.assert_close(ground.plane.normal.norm(dim=-1), torch.ones(2).double())


def test_to_recording_is_the_inverse():
    ground = a_ground()
    points = torch.randn(2, 5, 7, 3).double()
    world = transform(ground.T_world_recording[:, None], points)
    scene = scene_with(ground)
    torch.testing.assert_close(scene.to_recording(world), points)
    ahead = scene.to_recording(world + scene_up(world)) - scene.to_recording(world)
    torch.testing.assert_close(scene.to_recording_directions(scene_up(world)), ahead)
    known = Scene.create(2, like=points)
    assert torch.equal(known.to_recording(points), points)
    assert torch.equal(known.to_recording_directions(points), points)


def test_a_new_scene_has_every_point_where_the_model_says():
    scene = Scene.create(2, 5, like=torch.zeros(1, dtype=torch.float64))
    assert torch.equal(scene.offsets, torch.zeros(2, 5, 3, dtype=torch.float64))
    assert Scene.create(3, like=torch.zeros(1)).offsets.shape == (3, 0, 3)
    assert scene.ground is None


def scene_up(like: torch.Tensor) -> torch.Tensor:
    return like.new_tensor([0.0, 0.0, 1.0]).expand_as(like)


def test_a_motion_is_carried_as_its_body_is(toy_body):
    motion = laws.a_motion(toy_body)
    T = a_ground().T_world_recording
    moved = motion.carried(T, toy_body.rest_joints(motion.shape)[..., 0, :])
    torch.testing.assert_close(
        toy_body.pose(moved).joints, transform(T[:, None], toy_body.pose(motion).joints)
    )
    torch.testing.assert_close(
        toy_body.pose(moved).vertices, transform(T[:, None], toy_body.pose(motion).vertices)
    )


@pytest.mark.parametrize("name", ["free", "pose"])
def test_variables_are_carried_as_the_motion_they_stand_for(name, toy_body):
    """Also away from the start, where the variables are not zero."""
    prior: Any = FreeMotion() if name == "free" else PosePrior.load()
    motion = laws.a_motion(toy_body)
    variables = prior.encode(motion)
    g = torch.Generator().manual_seed(1)

    def step(t):
        return t + 0.05 * torch.randn(t.shape, generator=g).double()

    variables = variables.replace(
        translation=step(variables.translation),
        root=step(variables.root),
        pose=step(variables.pose),
        shape=step(variables.shape),
    )
    T = a_ground().T_world_recording
    there = prior.decode(variables.carried(T, toy_body)).motion
    here = prior.decode(variables).motion
    expected = here.carried(T, toy_body.rest_joints(here.shape)[..., 0, :])
    torch.testing.assert_close(there.translation, expected.translation)
    torch.testing.assert_close(there.rotations, expected.rotations)


def test_images_do_not_see_the_ground(toy_body):
    """The motion is found in the recording's frame: a better ground leaves the data explained."""
    motion = laws.a_motion(toy_body)
    seen = filmed(toy_body, motion)
    away = motion.replace(translation=motion.translation + 0.03)
    start = a_ground()
    tilt, lift = start.tilt.clone().requires_grad_(), start.lift.clone().requires_grad_()
    ground = start.replace(tilt=tilt, lift=lift)
    world = away.carried(ground.T_world_recording, toy_body.rest_joints(away.shape)[..., 0, :])
    decoded = FreeMotion().decode(FreeMotion().encode(world))
    value = seen(Estimate(decoded, toy_body.pose(decoded.motion), scene_with(ground)))
    torch.testing.assert_close(value, seen(laws.estimate_of(toy_body, away)))
    size = value.detach().max()
    for gradient in torch.autograd.grad(value.sum(), (tilt, lift)):
        assert gradient.abs().max() < 1e-9 * size


def height(estimate: Estimate) -> torch.Tensor:
    """Something that does see it: squared heights of the feet."""
    return estimate.body.joints[..., [10, 11], 2].square().sum((-2, -1))


def test_a_stage_finds_the_ground_and_leaves_the_recording_as_it_is(toy_body):
    motion = laws.a_motion(toy_body)
    seen = filmed(toy_body, motion)
    start = scene_with(UnknownGround.create(torch.zeros(2, 3).double()))
    terms = (Term("images", seen, 1.0), Term("height", height, 10.0))
    stage = Stage("ground", FreeMotion(), terms, GROUND)
    variables, scene, _ = laws.minimised(stage, toy_body, FreeMotion().encode(motion), start)
    assert torch.equal(variables.translation, motion.translation)
    assert scene.ground is not None
    assert (scene.ground.lift.abs() > 0.01).all()
    found = motion.carried(
        scene.ground.T_world_recording, toy_body.rest_joints(motion.shape)[..., 0, :]
    )
    feet = toy_body.pose(found).joints[..., [10, 11], 2].abs().mean((-2, -1))
    assert (feet < toy_body.pose(motion).joints[..., [10, 11], 2].abs().mean((-2, -1))).all()


def test_variables_that_cannot_be_carried_are_refused_with_a_way_out(toy_body):
    @dataclass(frozen=True)
    class Plain(TensorStruct):
        motion: Motion

    class Fixed(Prior[Plain]):
        def encode(self, motion):
            return Plain(motion)

        def decode(self, variables):
            return Decoded(variables.motion)

    motion = laws.a_motion(toy_body)
    stage = Stage("x", Fixed(), (Term("height", height, 1.0),), frozenset({"motion.translation"}))
    known = Scene.create(2, like=motion.translation)
    laws.minimised(stage, toy_body, Plain(motion), known)
    with pytest.raises(ValueError, match="cannot be fitted with an unknown ground"):
        laws.minimised(stage, toy_body, Plain(motion), scene_with(a_ground()))


def test_another_focal_length_keeps_the_size_of_what_stands_at_the_distance():
    # camera looking along +x from the origin; two points 4 m before it, a metre apart
    origin, forward = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]).double()
    one = full_hd_camera().to(dtype=torch.float64).placed(origin, forward)
    camera = one.map(lambda t: t.expand(1, 1, *t.shape))
    places = [[4.0, -0.5, 1.0], [4.0, 0.5, 1.0], [8.0, 0.5, 1.0]]
    points = torch.tensor(places).double()[None, None]
    lens = UnknownLens(torch.full((1,), 2.0).double(), torch.full((1,), 4.0).double())
    factor = torch.tensor(2.0 * ZOOM).exp()
    torch.testing.assert_close(lens.factor.float(), factor[None])
    other = lens.applied_to(camera)
    focal, centre = camera.camera_matrix[..., :2, :2], camera.camera_matrix[..., 2]
    torch.testing.assert_close(other.camera_matrix[..., :2, :2], factor * focal)
    torch.testing.assert_close(other.camera_matrix[..., 2], centre)
    before, after = camera.project(points).pixels, other.project(points).pixels
    torch.testing.assert_close(after[..., :2, :], before[..., :2, :])
    # farther things grow with the focal length: 8 m become 4 m times the factor, plus 4 m
    middle = camera.camera_matrix[0, 0, 0, 2]
    grown = (after[0, 0, 2, 0] - middle) / (before[0, 0, 2, 0] - middle)
    torch.testing.assert_close(grown.float(), 8 * factor / (4 + 4 * factor))
    unchanged = UnknownLens.create(lens.distance).applied_to(camera)
    torch.testing.assert_close(unchanged.T_camera_world, camera.T_camera_world)
