"""Forward kinematics of the 22-joint tree, with its derivative written out."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.arrays import constant
from recon.core.skeleton import FAMILIES, PARENTS


def forward_kinematics(
    rotations: Float[Tensor, "*batch time 22 3 3"], rest: Float[Tensor, "*batch 22 3"]
) -> tuple[Float[Tensor, "*batch time 22 3 3"], Float[Tensor, "*batch time 22 3"]]:
    """World rotations and positions of all joints, the root at its rest place.

    Child c of parent p: O_c = O_p R_c and x_c = x_p + O_p b_c with b_c the bone from p to c at
    rest. The derivative walks the same tree backwards, which is cheaper than recording each
    small product; joints come first in memory, so that a level is one block.
    """
    parents = constant(tuple(PARENTS[1:]), rest.device)
    bones = torch.cat((rest[..., :1, :], rest[..., 1:, :] - rest[..., parents, :]), -2)
    bones = bones[..., None, :, :].expand(rotations.shape[:-1])
    return _KinematicChain.apply(rotations, bones)


class _KinematicChain(torch.autograd.Function):
    """Rigid transforms [R_c | b_c] of every joint, multiplied along the tree."""

    @staticmethod
    def forward(ctx: Any, rotations: Tensor, bones: Tensor) -> tuple[Tensor, Tensor]:
        shape = rotations.shape[:-2]
        local = torch.cat((rotations, bones[..., None]), -1).reshape(-1, 22, 3, 4)
        local = local.transpose(0, 1).contiguous()
        world = torch.empty_like(local)
        world[0] = local[0]
        for children, parents in FAMILIES:
            torch.matmul(world[parents][..., :3], local[children], out=world[children])
            world[children][..., 3] += world[parents][..., 3]
        ctx.save_for_backward(local, world)
        out = world.transpose(0, 1).unflatten(0, shape[:-1])
        return out[..., :3], out[..., 3]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        local, world = ctx.saved_tensors
        shape = gradients[0].shape[:-2]
        g_world = torch.cat((gradients[0], gradients[1][..., None]), -1).reshape(-1, 22, 3, 4)
        g_world = g_world.transpose(0, 1).contiguous()
        g_local = torch.empty_like(local)
        for children, parents in reversed(FAMILIES):
            g = g_world[children]
            torch.matmul(world[parents][..., :3].mT, g, out=g_local[children])
            up = torch.matmul(g, local[children].mT)
            moved = g[..., 3]
            if isinstance(parents, int):
                up, moved = up.sum(0), moved.sum(0)
            g_world[parents][..., :3] += up
            g_world[parents][..., 3] += moved
        g_local[0] = g_world[0]
        out = g_local.transpose(0, 1).unflatten(0, shape[:-1])
        return out[..., :3], out[..., 3]
