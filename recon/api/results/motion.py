"""A motion with what is known about it: what most functions of `recon` return."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.api.results.printing import described_motion, in_ten_lines
from recon.body.identities import height
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding
from recon.formats.motions import MotionFile, save_motion
from recon.formats.results.certainty import JointCertainty
from recon.formats.results.joint_table import write_joint_table
from recon.formats.results.reports import versions
from recon.formats.results.writing import writing_file


@dataclass(frozen=True, repr=False)
class MotionResult(ABC):
    """A motion with its joints, contacts and ground; tensors have no leading axis."""

    file: MotionFile
    """What `save` writes: the motion, joints, contacts, ground and camera."""
    body: BodyModel
    """The body that moves."""
    warnings: tuple[Finding, ...]
    """What should be read before the result is used."""

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
        """1 where a joint stands on the ground of the room, 0 elsewhere.

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
        return JointCertainty.of(self.file)

    @abstractmethod
    def report(self) -> dict[str, Any]:
        """What is written beside the motion, in plain values."""

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
        said = self.report() if report is None else report
        with writing_file(Path(path), said, overwrite=overwrite) as staged:
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
        said = self.report() if report is None else report
        with writing_file(Path(path), said, overwrite=overwrite) as staged:
            write_joint_table(staged, self.file, self.joints)

    def _headline(self) -> str:
        tall = float(height(self.body, self.motion.shape))
        return f"{type(self).__name__}: {described_motion(self.motion, tall)}"


@dataclass(frozen=True, repr=False)
class Made(MotionResult):
    """A motion that was made from other motions, by a prior, or from a recording."""

    about: Mapping[str, Any]
    """What the function knows about it, in plain values, as its report has it."""
    summary: tuple[str, ...] = ()
    """A summary in a few lines for the person at the terminal."""
    repairs: tuple[Finding, ...] = ()
    """What was wrong with a recording and was put right."""
    diagnosis: tuple[Finding, ...] = ()
    """What is worth knowing but is no fault."""

    def report(self) -> dict[str, Any]:
        """What is written beside the motion."""
        return {**self.about, "versions": versions()}

    def __repr__(self) -> str:
        """A summary of at most ten lines: length, person, what is known, and findings."""
        found = [f"repaired: {finding.message}" for finding in self.repairs]
        found += [f"warning: {finding.message}" for finding in self.warnings]
        return in_ten_lines(self._headline(), self.summary, found)
