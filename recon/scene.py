"""What surrounds the motion and belongs to no prior."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.struct import TensorStruct


@dataclass(frozen=True)
class Scene(TensorStruct):
    """Unknowns shared by all frames of a clip, optimised beside the prior's variables."""

    offsets: Float[Tensor, "*batch offsets 3"]
    """Where tracked points sit away from their place on the model, in the frame of their bone.

    Metres. Markers stand off the skin and joints of another skeleton lie elsewhere; an
    observation that allows for that names its rows here (MoSh's latent markers).
    """

    @classmethod
    def create(cls, clips: int, offsets: int = 0, *, like: Tensor) -> "Scene":
        """A scene in which everything sits where the model says."""
        return cls(offsets=torch.zeros(clips, offsets, 3, dtype=like.dtype, device=like.device))
