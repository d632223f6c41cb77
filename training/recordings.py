"""Clips of the converted corpus in memory, their poses, and mirror images."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.motion import Motion
from recon.core.skeleton import MIRROR


@dataclass(frozen=True)
class CorpusClip:
    """One recording, converted to the bundled body."""

    name: str
    subject: str
    motion: Motion


def mirrored_rotations(
    rotations: Float[Tensor, "*shape 22 3 3"],
) -> Float[Tensor, "*shape 22 3 3"]:
    """Joint rotations of poses mirrored left to right."""
    flip = rotations.new_tensor([-1.0, 1.0, 1.0])
    return (flip[:, None] * rotations * flip)[..., list(MIRROR), :, :]


def poses_of(clips: Sequence[CorpusClip], rate: float, most: int) -> Float[Tensor, "poses 22 3 3"]:
    """Sample `rate` poses per second from all clips; add the mirror image of each.

    No subject gives more than about `most` (before mirroring), taken evenly from all its clips:
    whoever was recorded for an hour must not decide alone what a pose is.
    """
    by_subject: dict[str, list[Tensor]] = {}
    for clip in clips:
        step = max(1, round(clip.motion.fps / rate))
        by_subject.setdefault(clip.subject, []).append(clip.motion.rotations[::step])
    rows = [torch.cat(own) for own in by_subject.values()]
    together = torch.cat([row[:: -(-len(row) // most)] for row in rows])
    return torch.cat((together, mirrored_rotations(together)))
