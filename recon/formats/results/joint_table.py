"""A table of joints (CSV): a row per frame, with how sure every joint is where that is known."""

import csv
from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from recon.core.skeleton import JOINTS
from recon.formats.files.opening import replacing
from recon.formats.motions import MotionFile


def write_joint_table(path: Path, file: MotionFile, joints: Float[Tensor, "time 22 3"]) -> None:
    """Write `frame`, `time` and then, joint by joint, the columns of `joint_columns`.

    Args:
        path: the table to write.
        file: the motion; what it does not know has no columns.
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
    """Names and values of the columns, for every joint in turn.

    `pelvis_x`, `pelvis_y`, `pelvis_z`: its position in the world, metres. `pelvis_std`: standard
    deviation of each of these coordinates, metres. `pelvis_observed`: 1 where it was seen and 0
    where it was inferred. `pelvis_contact`: probability of its contact with the ground. The last
    three are there where the motion file has them.
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
