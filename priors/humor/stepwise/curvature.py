"""How stiff HuMoR's steps are on average: a constant Gauss-Newton Hessian of a step's energies.

A step of collocation depends on four frames: velocities of its two states are central differences.
In the heading of the frame that it starts from, its curvature is about the same wherever people
are and whatever they do, so the mean over the training corpus tells a minimiser most of what it
needs, for nothing. Only the way to the minimum depends on it, not the minimum.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from priors.checkpoints import named_checkpoint
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.struct import TensorStruct
from recon.method.newton.model import FRAME
from recon.solver.banded import Banded

SPAN = 4
"""Frames that a step depends on, from the one before it starts to the one after it ends."""
_SIZE = SPAN * FRAME + 16


@dataclass(frozen=True)
class StepCurvature(TensorStruct):
    """Mean Σ JᵀJ of a step's residuals by the steps of its frames, and by the shape.

    Residuals are those of the energies in nats; translations are in the heading of the frame
    that the step starts from.
    """

    error: Float[Tensor, "numbers numbers"]
    latents: Float[Tensor, "numbers numbers"]

    @classmethod
    def load(cls, path: str | Path = "open") -> "StepCurvature":
        """The bundled one, or one of a file.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds something else.
        """
        shapes = {"error": (_SIZE, _SIZE), "latents": (_SIZE, _SIZE)}
        roots = named_checkpoint(path, "humor_steps").require(shapes)
        found = {name: root.double() @ root.double().mT for name, root in roots.items()}
        return cls(**{name: matrix.float() for name, matrix in found.items()})

    def add(self, motion: Motion, hessian: Banded, error: float, latents: float) -> None:
        """Add the curvature of all steps of a clip.

        Args:
            motion: of one clip, without a batch axis.
            hessian: what it is added to, by the steps of its frames and by the shape.
            error: weight of a step's error, latents: of its surprise, per nat.
            latents: weight of its surprise.
        """
        like, steps, moved = motion.translation, motion.frames - 1, SPAN * FRAME
        whole = (error * self.error + latents * self.latents).to(like)
        size = hessian.corner.shape[-1]
        exists = (motion.valid[1:] & motion.valid[:-1]).to(like)
        turn = so3.heading(motion.rotations[:-1, 0]).mT
        mean = whole[:moved, :moved].unflatten(0, (SPAN, FRAME)).unflatten(2, (SPAN, FRAME))
        edge = whole[:moved, moved : moved + size].unflatten(0, (SPAN, FRAME))
        hessian.corner.add_(exists.sum() * whole[moved : moved + size, moved : moved + size])
        for a in range(SPAN):
            first, stop = max(0, 1 - a), min(steps, steps + 2 - a)
            rows = slice(first, stop)
            frame = slice(first + a - 1, stop + a - 1)
            hessian.border[frame] += _turned(turn[rows], edge[a], exists[rows])
            for b in range(a, SPAN):
                last = min(stop, steps + 2 - b)
                rows, frame = slice(first, last), slice(first + a - 1, last + a - 1)
                left = _turned(turn[rows], mean[a, :, b], exists[rows])
                both = _turned(turn[rows], left.mT, None).mT
                hessian.inner[frame, b - a] += both


def _turned(turn: Tensor, block: Tensor, exists: Tensor | None) -> Float[Tensor, "steps 69 n"]:
    """The rows of a block, the first three of which are of translations, in the world."""
    block = block.expand(len(turn), *block.shape[-2:])
    found = torch.cat((turn @ block[:, :3], block[:, 3:]), 1)
    return found if exists is None else exists[:, None, None] * found


@lru_cache(maxsize=1)
def bundled_curvature() -> StepCurvature:
    """The curvature that belongs to the weights in the package; others differ little from it."""
    return StepCurvature.load()
