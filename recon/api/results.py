"""A motion with what is known about it: what most functions of `recon` return."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.identities import height
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.diagnosis.examination import ResidualSummary
from recon.diagnosis.findings import Finding
from recon.formats.joint_table import JointCertainty, write_joint_table
from recon.formats.motions import MotionFile, save_motion
from recon.formats.outputs import Kind, Output
from recon.formats.reports import versions
from recon.formats.writing import writing, writing_file

Tables = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""Numbers for the person at the terminal: rows of columns, by title and by name."""
_KNOWN, _FINDINGS = 3, 4
"""Lines of them at most."""
WIDEST = 96
"""Characters of a line."""


def in_ten_lines(first: str, known: Sequence[str], found: Sequence[str]) -> str:
    """A headline, what is known, and what was found.

    Args:
        first: the headline.
        known: lines, such as one for every observation.
        found: repairs and warnings.
    """
    lines = [*shortened(known, _KNOWN, "lines"), *shortened(found, _FINDINGS, "findings")]
    return "\n".join([first, *map(one_line, lines)])


def described_motion(motion: Motion, tall: float) -> str:
    """How long a motion of one clip lasts, and how tall the person is, metres."""
    seconds = (motion.frames - 1) / motion.fps
    return (
        f"{motion.frames} frames, {seconds:.2f} s at {motion.fps:g} frames per second, "
        f"a person of {tall:.2f} m"
    )


def described_residuals(residuals: Sequence[ResidualSummary]) -> list[str]:
    """How near the fit is to every observation, one line each."""
    return [_sensor(one) for one in residuals]


def _sensor(one: ResidualSummary) -> str:
    """An observation in one line."""
    seen = "nothing seen" if one.median is None else f"median residual {_size(one.median, one)}"
    return f"{one.name}: noise {_size(one.noise, one)}, {seen}"


def _size(value: float, one: ResidualSummary) -> str:
    if one.unit == "metres":
        return f"{100 * value:.1f} cm"
    return f"{value:.{2 if one.unit == 'radians' else 1}f} {one.unit}"


def one_line(text: str) -> str:
    """The beginning of a message, indented, in one line."""
    text = "  " + " ".join(text.split())
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."


def shortened(lines: Sequence[str], count: int, noun: str) -> list[str]:
    """The first lines, and how many more there are."""
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

    @property
    def tables(self) -> Tables:
        """Its most important numbers."""
        return {}

    @abstractmethod
    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """What is written beside the motion, in plain values.

        Args:
            inputs: SHA-256 of the files that were read, by path; none by default.
            settings: how it was made, by name.
        """

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
    """A motion made from other motions, by a prior, or from a recording."""

    about: Mapping[str, Any]
    """What the function knows about it, in plain values, as its report has it."""
    summary: tuple[str, ...] = ()
    """A summary in a few lines for the person at the terminal."""
    repairs: tuple[Finding, ...] = ()
    """What was wrong with a recording and was put right."""
    diagnosis: tuple[Finding, ...] = ()
    """What is worth knowing but is no fault."""
    shown: Tables = field(default_factory=dict)
    """Numbers for the person at the terminal."""

    @property
    def tables(self) -> Tables:
        """Its most important numbers."""
        return self.shown

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """What is written beside the motion; see `MotionResult.report`."""
        return {**self.about, **told(inputs, settings)}

    def __repr__(self) -> str:
        """A summary of at most ten lines: length, person, what is known, and findings."""
        found = [f"repaired: {finding.message}" for finding in self.repairs]
        found += [f"warning: {finding.message}" for finding in self.warnings]
        return in_ten_lines(self._headline(), self.summary, found)


@dataclass(frozen=True, repr=False)
class MotionResults:
    """Several motions, used like a tuple."""

    made: tuple[Made, ...]
    """Each with its motion, joints, contacts and ground."""
    noun: str
    """What one of them is called, in names of files: "sample"."""
    warnings: tuple[Finding, ...] = ()
    """What should be read before they are used."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """What is known of all of them, in plain values."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """What was taken for settings that the caller left open."""

    @property
    def tables(self) -> Tables:
        """What is known of each."""
        rows = {f"{self.noun} {k}": one.about for k, one in enumerate(self.made)}
        return {repr(self).splitlines()[0]: rows}

    def __len__(self) -> int:
        """How many they are."""
        return len(self.made)

    def __getitem__(self, index: int) -> Made:
        """One of them."""
        return self.made[index]

    def __iter__(self) -> Iterator[Made]:
        """One after the other."""
        return iter(self.made)

    def report(
        self,
        out: Path | str,
        inputs: Mapping[str, str] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """What is written beside them, in plain values.

        Args:
            out: where they are written, as `save` takes it.
            inputs: SHA-256 of the files that were read, by path; none by default.
            settings: how they were made, by name.
        """
        path = Path(out)
        names = file_names(path, len(self), self.noun)
        paths = [path] if path.suffix == ".npz" else [path / name for name in names]
        files = {str(p): dict(one.about) for p, one in zip(paths, self.made, strict=True)}
        warnings = [finding.message for finding in self.warnings]
        asked = None if settings is None else {**settings, **self.settings}
        return {"files": files, "warnings": warnings, **self.about, **told(inputs, asked)}

    def save(
        self,
        out: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write one motion file, or a folder of `sample_000.npz` and so on, and the report.

        Args:
            out: file (.npz) for one motion, whose report is OUT.json, or a folder for several, in
                which the report is `report.json`.
            overwrite: replace what is there and recon did not write.
            report: what to write instead of `report(out)`.

        Raises:
            ReconError: when there are several motions for one file.
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
        """
        path = Path(out)
        names = file_names(path, len(self), self.noun)
        one = path.suffix == ".npz"
        output = Output(path, Kind.FILE if one else Kind.FOLDER)
        said = self.report(path) if report is None else report
        with writing(output, report=said, overwrite=overwrite) as (staged,):
            for name, made in zip(names, self.made, strict=True):
                save_motion(staged if one else staged / name, made.file)

    def __repr__(self) -> str:
        """A summary of at most ten lines: number, lengths, and findings."""
        motion = self.made[0].motion
        seconds = (motion.frames - 1) / motion.fps
        first = (
            f"{len(self)} motions ({self.noun}) of {motion.frames} frames, {seconds:.2f} s at "
            f"{motion.fps:g} frames per second"
        )
        kept = [one_line(repr(one).splitlines()[0]) for one in self.made]
        found = [f"warning: {finding.message}" for finding in self.warnings]
        return in_ten_lines(first, kept, found)


def told(inputs: Mapping[str, str] | None, settings: Mapping[str, Any] | None) -> dict[str, Any]:
    """The end of every report: settings and inputs where they are known, and versions."""
    known = {"settings": settings, "inputs": inputs}
    return {key: dict(one) for key, one in known.items() if one is not None} | {
        "versions": versions()
    }


def file_names(out: Path, count: int, noun: str) -> list[str]:
    """Names of the files to write: one file, or several in a folder.

    Raises:
        ReconError: when there is no motion, or there are several for one file.
    """
    if count < 1:
        raise ReconError(f"nothing to write: expected one motion or more, got {count}")
    if out.suffix != ".npz":
        return [f"{noun}_{k:03d}.npz" for k in range(count)]
    if count > 1:
        raise ReconError(f"{out} is one file, but {count} motions were asked for; give a folder")
    return [out.name]
