"""Summarises standard deviations of a motion's joints, and writes joints as a CSV table."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.motion import MotionFile
from recon.core.skeleton import JOINTS
from recon.formats.replacing import replacing


@dataclass(frozen=True)
class JointCertainty:
    """Median standard deviations of joint coordinates, for seen and for inferred joints."""

    seen: float | None
    """Median of joints that a sensor saw, metres; None where none was seen."""
    hidden: float | None
    """Median of joints that were inferred, metres; None where none was."""
    hidden_share: float
    """Share of the joints, over all frames, that were inferred."""

    @classmethod
    def of(cls, file: MotionFile) -> "JointCertainty | None":
        """Compute the medians over a motion file; None if it has no standard deviations."""
        if file.joint_std is None:
            return None
        std = file.joint_std.detach().cpu()
        observed = file.observed
        seen = torch.ones_like(std, dtype=torch.bool) if observed is None else observed.cpu()
        return cls(_median_std(std, seen), _median_std(std, ~seen), float((~seen).double().mean()))

    def __str__(self) -> str:
        """Format the medians as `1.1 cm where seen, 5.3 cm where inferred (17 % of joints)`."""
        parts: list[str] = []
        if self.seen is not None:
            parts.append(f"{100 * self.seen:.1f} cm where seen")
        if self.hidden is not None:
            share = f"{100 * self.hidden_share:.0f} % of the joints"
            parts.append(f"{100 * self.hidden:.1f} cm where inferred ({share})")
        return ", ".join(parts)


def _median_std(std: Float[Tensor, "time 22"], rows: Bool[Tensor, "time 22"]) -> float | None:
    return float(std[rows].median()) if bool(rows.any()) else None


def write_joint_table(path: Path, file: MotionFile, joints: Float[Tensor, "time 22 3"]) -> None:
    """Write joints as a CSV table with `frame`, `time` and the columns of `joint_columns`.

    Args:
        path: the table to write.
        file: the motion; quantities that it lacks have no columns.
        joints: positions of its joints in the world, metres.
    """
    motion = file.motion
    names, values = joint_columns(file, joints)
    times = motion.start_time + np.arange(motion.frames) / motion.fps
    with replacing(path) as scratch, scratch.open("w", newline="", encoding="utf-8") as out:
        table = csv.writer(out, lineterminator="\n")
        table.writerow(("frame", "time", *names))
        for frame, (time, row) in enumerate(zip(times, values, strict=True)):
            table.writerow((frame, f"{time:.6f}", *(f"{value:.6g}" for value in row)))


def joint_columns(
    file: MotionFile, joints: Float[Tensor, "time 22 3"]
) -> tuple[list[str], Float[np.ndarray, "time columns"]]:
    """Return names and values of the columns of a joint table, joint after joint.

    For the pelvis: `pelvis_x`, `pelvis_y`, `pelvis_z`, position in the world, metres;
    `pelvis_std`, standard deviation of each coordinate, metres; `pelvis_observed`, 1 where it was
    seen and 0 where it was inferred; `pelvis_contact`, probability of contact with the ground.
    The last three are left out where the motion file lacks them.
    """
    parts: dict[str, Tensor | None] = {
        **{axis: joints[..., k] for k, axis in enumerate("xyz")},
        "std": file.joint_std,
        "observed": file.observed,
        "contact": file.contacts,
    }
    known = {name: value for name, value in parts.items() if value is not None}
    names = [f"{joint}_{part}" for joint in JOINTS for part in known]
    columns = [value.detach().cpu().double().numpy() for value in known.values()]
    return names, np.stack(columns, -1).reshape(len(joints), len(names))
