"""The Gauss-Newton Hessian of a motion while residuals are added to it, banded in time.

The border beside the frames holds what belongs to all of them: the shape, and where it is unknown
the ground.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.solver.blocks import Bordered

FRAME = 69
"""Coordinates of a frame: three of the translation, three of every joint's rotation step."""
LEAST = 0.1
"""Curvature that every coordinate has at least, 1 / metres² or 1 / radians²: what nothing holds is
unknown by no more than three metres and half a turn."""


@dataclass(frozen=True)
class Accumulated:
    """Blocks of the Hessian while residuals are added, in place."""

    frames: Float[Tensor, "time 3 n n"]
    """[t, k]: the block that couples frame t with frame t + k."""
    border: Float[Tensor, "time n m"]
    shape: Float[Tensor, "m m"]

    @classmethod
    def zero(cls, frames: int, size: int, like: Tensor) -> "Accumulated":
        """Nothing but the least curvature of every coordinate."""
        m = size - FRAME
        blocks = like.new_zeros(frames, 3, FRAME, FRAME)
        blocks[:, 0].diagonal(dim1=-2, dim2=-1).add_(LEAST)
        corner = LEAST * torch.eye(m, dtype=like.dtype, device=like.device)
        return cls(blocks, like.new_zeros(frames, FRAME, m), corner)

    def add_sensor(self, frame: Tensor, jacobian: Tensor, weight: Tensor) -> None:
        """Residuals of single moments, each at its frame."""
        whole = jacobian.mT @ (jacobian * weight[..., None])
        self._add(frame, whole)

    def add_poses(self, jacobian: Float[Tensor, "time residuals 63"]) -> None:
        """Whitened residuals of poses, by the rotation steps of all joints but the root."""
        first = FRAME - jacobian.shape[-1]
        self.frames[:, 0, first:, first:] += jacobian.mT @ jacobian

    def add_frames(self, jacobian: Tensor) -> None:
        """Whitened residuals of single frames."""
        self._add(torch.arange(len(jacobian)), jacobian.mT @ jacobian)

    def _add(self, frame: Tensor, whole: Tensor) -> None:
        self.frames[:, 0].index_add_(0, frame, whole[:, :FRAME, :FRAME])
        self.border.index_add_(0, frame, whole[:, :FRAME, FRAME:])
        self.shape.add_(whole[:, FRAME:, FRAME:].sum(0))

    def add_accelerations(self, joints: Tensor, weight: float) -> None:
        """½ weight |p_(t-1) - 2 p_t + p_(t+1)|² of all joints."""
        if len(joints) < 3:
            return
        moved, shaped = joints[..., :FRAME], joints[..., FRAME:]
        sign = joints.new_tensor([1.0, -2.0, 1.0])
        inner = len(joints) - 2
        bend = shaped[:-2] - 2 * shaped[1:-1] + shaped[2:]
        self.shape.add_(weight * (bend.mT @ bend).sum(0))
        for a in range(3):
            left = moved[a : a + inner]
            self.border[a : a + inner] += weight * sign[a] * (left.mT @ bend)
            for b in range(a, 3):
                right = moved[b : b + inner]
                pair = weight * sign[a] * sign[b] * (left.mT @ right)
                self.frames[a : a + inner, b - a] += pair

    def bordered(self) -> Bordered:
        """Two frames to a block, so that only neighbouring blocks couple."""
        count = len(self.frames)
        pairs = -(-count // 2)
        n = 2 * FRAME
        own = self.frames.new_zeros(pairs, 2, 2, FRAME, FRAME)
        beside = self.frames.new_zeros(pairs, 2, 2, FRAME, FRAME)
        even, odd = self.frames[::2], self.frames[1::2]
        full = len(odd)
        own[:, 0, 0] = even[:, 0]
        own[:full, 1, 1] = odd[:, 0]
        own[full:, 1, 1] = torch.eye(FRAME, dtype=own.dtype, device=own.device)
        own[:full, 0, 1] = even[:full, 1]
        own[:full, 1, 0] = even[:full, 1].mT
        beside[: pairs - 1, 0, 0] = even[:-1, 2]
        beside[: pairs - 1, 1, 0] = odd[: pairs - 1, 1]
        if full > 1:
            beside[: full - 1, 1, 1] = odd[:-1, 2]
        border = self.border.new_zeros(pairs, 2, FRAME, self.border.shape[-1])
        border[:, 0], border[:full, 1] = self.border[::2], self.border[1::2]
        return Bordered(
            diagonal=own.transpose(2, 3).reshape(pairs, n, n),
            upper=beside[: pairs - 1].transpose(2, 3).reshape(pairs - 1, n, n),
            border=border.reshape(pairs, n, -1),
            corner=self.shape,
        )
