"""Torques and inertia of points on bones, beside derivatives of the points themselves."""

import torch

from observations.start.bone_poses import gradient_by_rotations, hessian_by_rotations
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS, PARENTS

BONES, POINTS = len(JOINTS), 15
RANDOM = torch.Generator().manual_seed(0)


def moved(bones, step):
    """Bones after a translation and turns about all joints, which carry what hangs from them."""
    turns = step[3:].view(BONES, 3)
    orientations, joints = list(bones[..., :3]), list(bones[..., 3])
    for joint in range(BONES):
        turn = torch.matrix_exp(so3.hat(turns[joint]))
        about = joints[joint]
        for below in range(joint, BONES):
            above = below
            while above > joint:
                above = PARENTS[above]
            if above == joint:
                orientations[below] = turn @ orientations[below]
                joints[below] = about + turn @ (joints[below] - about)
    placed = torch.cat((torch.stack(orientations), torch.stack(joints)[..., None]), -1)
    return torch.cat((placed[..., :3], placed[..., 3:] + step[:3, None]), -1)


def test_torques_and_inertia_are_the_derivatives_of_the_points():
    bones = torch.randn(BONES, 3, 4, generator=RANDOM, dtype=torch.float64)
    bones[..., :3] = so3.exp(torch.randn(BONES, 3, generator=RANDOM, dtype=torch.float64))
    bone = torch.randint(BONES, (POINTS,), generator=RANDOM)
    place = torch.randn(POINTS, 3, generator=RANDOM, dtype=torch.float64)
    column = torch.cat((place, torch.ones(POINTS, 1, dtype=torch.float64)), -1)
    seen = torch.randn(POINTS, 3, generator=RANDOM, dtype=torch.float64)
    weight = torch.rand(POINTS, generator=RANDOM, dtype=torch.float64)

    def points(step):
        return (moved(bones, step)[bone] @ column[..., None])[..., 0]

    zero = torch.zeros(3 + 3 * BONES, dtype=torch.float64)
    jacobian = torch.autograd.functional.jacobian(points, zero)
    away = points(zero) - seen
    gradient = torch.einsum("n,ni,nic->c", weight, away, jacobian)
    hessian = torch.einsum("n,nic,nid->cd", weight, jacobian, jacobian)

    force, stiffness = bones.new_zeros(1, BONES, 3, 4), bones.new_zeros(1, BONES, 4, 4)
    counted = weight[:, None] * column
    force[0].index_add_(0, bone, away[..., None] * counted[:, None])
    stiffness[0].index_add_(0, bone, column[..., None] * counted[:, None])
    push, turning = gradient_by_rotations(bones[None], force)
    mass, across, between = hessian_by_rotations(bones[None], stiffness)
    torch.testing.assert_close(torch.cat((push[0], turning[0].flatten())), gradient)
    upper = torch.cat((mass[0] * torch.eye(3, dtype=torch.float64), across[0]), -1)
    found = torch.cat((upper, torch.cat((across[0].mT, between[0]), -1)))
    torch.testing.assert_close(found, hessian)
