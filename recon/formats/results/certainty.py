"""How sure a motion is of its joints, in three numbers and in a line."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.formats.motions import MotionFile


@dataclass(frozen=True)
class JointCertainty:
    """Medians of the standard deviations of joints' coordinates, over frames and joints."""

    seen: float | None
    """Median of joints that a sensor saw, metres; None where none was seen."""
    hidden: float | None
    """Median of joints that were inferred, metres; None where none was."""
    hidden_share: float
    """Share of the joints, over all frames, that were inferred."""

    @classmethod
    def of(cls, file: MotionFile) -> "JointCertainty | None":
        """What a motion file says of its joints; None where it says nothing."""
        if file.joint_std is None:
            return None
        std = file.joint_std.detach().cpu()
        observed = file.observed
        seen = torch.ones_like(std, dtype=torch.bool) if observed is None else observed.cpu()
        return cls(_median(std, seen), _median(std, ~seen), float((~seen).double().mean()))

    def __str__(self) -> str:
        """Medians in words: `1.1 cm where seen, 5.3 cm where inferred (17 % of the joints)`."""
        parts: list[str] = []
        if self.seen is not None:
            parts.append(f"{100 * self.seen:.1f} cm where seen")
        if self.hidden is not None:
            share = f"{100 * self.hidden_share:.0f} % of the joints"
            parts.append(f"{100 * self.hidden:.1f} cm where inferred ({share})")
        return ", ".join(parts)


def _median(std: Float[Tensor, "time 22"], rows: Bool[Tensor, "time 22"]) -> float | None:
    return float(std[rows].median()) if bool(rows.any()) else None
