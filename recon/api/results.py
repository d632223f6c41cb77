"""A motion with its uncertainty and findings, which most functions of `recon` return."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ReconError, optional_module
from recon.core.motion import Motion, MotionFile
from recon.diagnosis.examination import ResidualSummary
from recon.diagnosis.findings import Finding

if TYPE_CHECKING:
    from recon.formats.joint_table import JointCertainty
else:
    from typing import Any as JointCertainty

Tables = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""Numbers for the person at the terminal: rows of columns, by title and by name."""
_KNOWN, _FINDINGS = 3, 4
"""Lines of them at most."""
WIDEST = 96
"""Characters of a line."""


def in_ten_lines(headline: str, facts: Sequence[str], findings: Sequence[str]) -> str:
    """At most ten lines: a headline, the known facts, and the findings.

    Args:
        headline: the first line.
        facts: lines, such as one for every observation.
        findings: repairs and warnings.
    """
    lines = [*first_lines(facts, _KNOWN, "lines"), *first_lines(findings, _FINDINGS, "findings")]
    return "\n".join([headline, *map(one_line, lines)])


def described_residual(summary: ResidualSummary) -> str:
    """Return one line of text with an observation's name, noise and median residual."""
    seen = (
        "nothing seen"
        if summary.median is None
        else f"median residual {_with_unit(summary.median, summary)}"
    )
    return f"{summary.name}: noise {_with_unit(summary.noise, summary)}, {seen}"


def _with_unit(value: float, summary: ResidualSummary) -> str:
    if summary.unit == "metres":
        return f"{100 * value:.1f} cm"
    return f"{value:.{2 if summary.unit == 'radians' else 1}f} {summary.unit}"


def one_line(text: str) -> str:
    """Return a message as one indented line, cut off if it is too long."""
    text = "  " + " ".join(text.split())
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."


def first_lines(lines: Sequence[str], count: int, noun: str) -> list[str]:
    """Return the first `count` lines, and if there are more, a line that says how many."""
    if len(lines) <= count:
        return list(lines)
    return [*lines[:count], f"and {len(lines) - count} more {noun}"]


@dataclass(frozen=True, repr=False)
class MotionResult(ABC):
    """A motion with its joints, contacts and ground; tensors have no leading axis."""

    file: MotionFile
    """What `save` writes: the motion, joints, contacts, ground and camera."""
    body: BodyModel
    """The body that moves."""
    warnings: tuple[Finding, ...]
    """Findings that may make the result wrong."""

    @property
    def motion(self) -> Motion:
        """The motion: world with z up; metres, rotation matrices, frames per second."""
        return self.file.motion

    @property
    def joints(self) -> Float[Tensor, "time 22 3"]:
        """Positions of the 22 joints in the world, metres."""
        assert self.file.joints is not None
        return self.file.joints

    @property
    def vertices(self) -> Float[Tensor, "time vertices 3"]:
        """Positions of the skin's vertices in the world, metres; computed at every call."""
        return self.body.pose(self.motion).vertices

    @property
    def contacts(self) -> Float[Tensor, "time 22"]:
        """1 where a joint is in contact with the ground of the room, else 0.

        Feet on the belt of a treadmill move in the room: where they are told by no belt's speed,
        all are 0, and so they are where there is no ground.
        """
        if self.file.contacts is None:
            return torch.zeros(self.joints.shape[:2]).to(self.joints)
        return self.file.contacts

    @property
    def ground(self) -> Float[Tensor, "4"] | None:
        """(nx, ny, nz, d): the points x of the ground have n·x = d in the world, metres.

        None where there is none (`recon.fit(..., ground=None)`).
        """
        return self.file.ground

    @property
    def observed(self) -> Bool[Tensor, "time 22"]:
        """False where a joint was inferred rather than seen."""
        if self.file.observed is None:
            return torch.ones(self.joints.shape[:2], dtype=torch.bool)
        return self.file.observed

    @property
    def joint_std(self) -> Float[Tensor, "time 22"] | None:
        """Standard deviation of a coordinate of every joint, metres; None where it is not known.

        Nine of ten errors along an axis are at most 1.645 times as large.
        """
        return self.file.joint_std

    @property
    def certainty(self) -> JointCertainty | None:
        """Median standard deviations of joints that were seen and of joints that were not."""
        from recon.formats.joint_table import JointCertainty  # imported only for reports

        return JointCertainty.of(self.file)

    @property
    def tables(self) -> Tables:
        """The most important numbers, as tables for a terminal."""
        return {}

    @abstractmethod
    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved beside the motion, in plain values.

        Args:
            inputs: SHA-256 of the files that were read, by path; none by default.
            settings: how it was made, by name.
        """

    def to_open3d(self, frame: int | None = None) -> Any:
        """The skin as `open3d.geometry.TriangleMesh`: a list, one per frame, or one frame's.

        Args:
            frame: number of the frame, from 0, or from the end where negative; None for all.

        Raises:
            ReconError: when there is no such frame, or Open3D is not installed.
        """
        count = self.motion.frames
        if frame is not None and not -count <= frame < count:
            raise ReconError(f"frame: expected one of the {count} frames, got {frame}")
        open3d = optional_module("open3d", "open3d", "a mesh of Open3D", "open3d")
        triangles = open3d.utility.Vector3iVector(self.body.faces.cpu().numpy())
        vertices = self.vertices if frame is None else self.vertices[frame][None]
        meshes = [
            open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(skin), triangles)
            for skin in vertices.detach().cpu().double().numpy()
        ]
        return meshes if frame is None else meshes[0]

    def save(
        self,
        path: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the motion file (AMASS .npz) and its report, PATH.json, together.

        Args:
            path: file to write.
            overwrite: replace files that are there and recon did not write.
            report: what to write beside it instead of `report()`.

        Raises:
            FileExistsError: when either is there and recon did not write it, unless `overwrite`.
        """
        # imported only when a result is written
        from recon.formats.motions import save_motion
        from recon.formats.writing import writing_file

        with writing_file(Path(path), report or self.report(), overwrite=overwrite) as staged:
            save_motion(staged, self.file)

    def save_table(
        self,
        path: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a table of the joints (CSV), a row per frame, and the report, PATH.json.

        Every joint has its position and standard deviation in metres, whether it was seen, and
        its contact with the ground.

        Args:
            path: file to write.
            overwrite: replace files that are there and recon did not write.
            report: what to write beside it instead of `report()`.

        Raises:
            FileExistsError: when either is there and recon did not write it, unless `overwrite`.
        """
        from recon.formats.joint_table import write_joint_table
        from recon.formats.writing import writing_file

        with writing_file(Path(path), report or self.report(), overwrite=overwrite) as staged:
            write_joint_table(staged, self.file, self.joints)

    def _headline(self) -> str:
        motion, tall = self.motion, float(self.body.height(self.motion.shape))
        return (
            f"{type(self).__name__}: {motion.frames} frames, {motion.duration:.2f} s at "
            f"{motion.fps:g} frames per second, a person of {tall:.2f} m"
        )


def closing_fields(
    inputs: Mapping[str, str] | None, settings: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the last fields of a report: settings, checksums of inputs, versions.

    Checksums are left out where the caller does not know them.
    """
    from recon.formats.reports import versions

    known = {"settings": settings, "inputs": inputs}
    return {key: dict(one) for key, one in known.items() if one is not None} | {
        "versions": versions()
    }
