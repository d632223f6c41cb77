"""Derivatives of points by turns about joints and by the shape, against differences."""

import pytest
import torch
from torch import Tensor

from recon.body.derivatives import BonePoints
from recon.body.levers import COORDINATES, Levers, ShapeLevers, bone_affines, rotations_after_turns
from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from recon.core.motion import Motion

STEP = 1e-6
FRAMES = 3


class Posed:
    """Some vertices of a body of some shape in random poses."""

    def __init__(self, body: BodyModel) -> None:
        generator = torch.Generator().manual_seed(1)

        def random(*shape: int) -> Tensor:
            return torch.randn(*shape, generator=generator, dtype=torch.float64)

        self.body = body
        self.vertices = torch.arange(0, len(body.template), len(body.template) // 9)
        self.shape = random(body.shape_size)
        self.rotations = so3.exp(0.5 * random(FRAMES, 22, 3))
        self.translation = random(FRAMES, 3)
        self.weights = random(FRAMES, len(self.vertices)).square()
        self.forces = random(FRAMES, 3, len(self.vertices))

    def carried(self) -> BonePoints:
        eye = torch.eye(len(self.vertices), dtype=torch.float64)
        none = eye.new_zeros(len(eye), 22)
        return BonePoints.create(self.body, self.shape, none, eye, self.vertices)

    def bones(self, steps: Tensor | None = None) -> Tensor:
        rest = self.body.rest_joints(self.shape)
        orientations, joints = forward_kinematics(self.rotations, rest)
        translation = self.translation
        if steps is not None:
            rotations = rotations_after_turns(self.rotations, orientations, steps[:, 3:])
            orientations, joints = forward_kinematics(rotations, rest)
            translation = translation + steps[:, :3]
        return bone_affines(orientations, joints + translation[:, None])

    def jacobian(self) -> Tensor:
        """Central differences, (frames, points, 3, 69)."""
        levers, columns = Levers.of(self.carried()), []
        for k in range(COORDINATES):
            step = torch.zeros(FRAMES, COORDINATES, dtype=torch.float64)
            step[:, k] = STEP
            ends = (levers.positions(self.bones(sign * step)) for sign in (1, -1))
            columns.append((next(ends) - next(ends)).mT / (2 * STEP))
        return torch.stack(columns, -1)


@pytest.fixture
def posed(body: BodyModel) -> Posed:
    return Posed(body)


def test_points_are_where_the_body_has_them(posed: Posed) -> None:
    motion = Motion.create(posed.translation, posed.rotations, posed.shape, 30.0)
    expected = posed.body.pose(motion).points(posed.vertices)
    torch.testing.assert_close(Levers.of(posed.carried()).positions(posed.bones()).mT, expected)


def test_derivatives_by_steps(posed: Posed) -> None:
    expected, levers = posed.jacobian(), Levers.of(posed.carried())
    bones = posed.bones()
    close = {"atol": 1e-7, "rtol": 0}
    torch.testing.assert_close(levers.jacobian(bones), expected, **close)
    pull = torch.einsum("tdv,tvdk->tk", posed.forces, expected)
    torch.testing.assert_close(levers.gradient_of(bones, posed.forces), pull, atol=1e-6, rtol=0)
    weighted = expected * posed.weights[..., None, None]
    stiffness = torch.einsum("tvdk,tvdl->tkl", weighted, expected)
    torch.testing.assert_close(
        levers.stiffness(bones, posed.weights), stiffness, atol=1e-6, rtol=0
    )
    found = torch.ones_like(stiffness)
    some = torch.tensor([0, 2])
    levers.add_height_hessian(found, some, bones[some], posed.weights[some])
    rising = torch.einsum("tvk,tvl->tkl", weighted[:, :, 2], expected[:, :, 2])
    torch.testing.assert_close(found[some], 1 + rising[some], atol=1e-6, rtol=0)
    assert (found[1] == 1).all()


def test_derivatives_by_the_shape(posed: Posed) -> None:
    found = ShapeLevers.of(posed.carried(), posed.body).jacobian_by_shape(posed.bones())
    for k in range(posed.body.shape_size):
        ends = []
        for sign in (1, -1):
            other = Posed(posed.body)
            other.shape[k] += sign * STEP
            ends.append(Levers.of(other.carried()).positions(other.bones()).mT)
        difference = (ends[0] - ends[1]) / (2 * STEP)
        torch.testing.assert_close(found[..., k], difference, atol=1e-7, rtol=0)
