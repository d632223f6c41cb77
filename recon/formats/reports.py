"""Reports beside results: what was done, and by which files can be told as recon's own.

A report is a JSON object. Beside what a verb has to say it holds

* `outputs`: SHA-256 of every file that was written with it, by name;
* `replaces`: the same of the files of a former run that these took the place of. A run that is
  killed between moving the report and moving its files leaves those behind, still as its own;
* `report_checksum`: SHA-256 of all its other entries, so that a report that somebody edited is
  told from one that is as recon wrote it.
"""

import csv
import json
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.skeleton import JOINTS
from recon.formats.motions import MotionFile
from recon.formats.opening import replacing
from recon.formats.replacing import file_checksum, value_checksum

_OUTPUTS, _REPLACES, _SEAL = "outputs", "replaces", "report_checksum"
_LARGEST = 1 << 28
"""Bytes; a larger JSON file is not looked into, and is somebody else's."""


@dataclass(frozen=True)
class Report:
    """A report that is as recon wrote it."""

    outputs: Mapping[str, str]
    """SHA-256 by name of file, relative to the report's folder."""
    replaces: Mapping[str, str]
    """Checksums of the files of a former run that were there before, by name."""

    def checksum_if_own(self, name: str, path: Path) -> str | None:
        """SHA-256 of a file of this name; None where it is not as recon wrote it."""
        known = {self.outputs.get(name), self.replaces.get(name)} - {None}
        if len(known) == 0 or not path.is_file():
            return None
        found = file_checksum(path)
        return found if found in known else None


def read_report(path: Path) -> Report | None:
    """The report of a JSON file; None where it is none, or was changed since it was written."""
    if not path.is_file() or path.stat().st_size > _LARGEST:
        return None
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or found.pop(_SEAL, None) != value_checksum(found):
        return None
    outputs, replaces = found.get(_OUTPUTS), found.get(_REPLACES, {})
    if not (isinstance(outputs, dict) and isinstance(replaces, dict)):
        return None
    return Report(outputs, replaces)


def report_text(
    report: Mapping[str, Any], outputs: Mapping[str, str], replaces: Mapping[str, str]
) -> str:
    """A report as the text of its file; what JSON cannot hold is written as `str` shows it.

    Args:
        report: what a verb has to say.
        outputs: SHA-256 of the files written with it, by name; empty where the report itself is
            all that is written.
        replaces: SHA-256 of recon's own files of these names that are there now.
    """
    whole = {**report, _OUTPUTS: dict(outputs)}
    if len(replaces) > 0:
        whole[_REPLACES] = dict(replaces)
    # as a reader will see it: keys are text, tuples are lists
    whole = json.loads(json.dumps(whole, default=str))
    return json.dumps({**whole, _SEAL: value_checksum(whole)}, indent=1) + "\n"


def versions() -> dict[str, str]:
    """What the result was made with."""
    return {
        "recon": version("motion-recon"),
        "torch": version("torch"),
        "python": platform.python_version(),
    }


def checksums(paths: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of input files by their path, for a report's `inputs`."""
    return {str(path): file_checksum(path) for path in paths}


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
