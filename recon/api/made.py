"""Results of functions that make motions otherwise than by a fit (sample, retarget, ...)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from recon.api.results import MotionResult, Tables, closing_fields, in_ten_lines, one_line
from recon.core.errors import ReconError
from recon.diagnosis.findings import Finding
from recon.formats.motions import save_motion
from recon.formats.outputs import Output, OutputKind
from recon.formats.writing import writing


@dataclass(frozen=True, repr=False)
class MadeMotion(MotionResult):
    """A motion made from other motions, by a prior, or from a recording."""

    about: Mapping[str, Any]
    """Numbers and settings of this motion, in plain values, as in its report."""
    summary: tuple[str, ...] = ()
    """A summary in a few lines for the person at the terminal."""
    repairs: tuple[Finding, ...] = ()
    """Faults of the recording that were repaired."""
    diagnosis: tuple[Finding, ...] = ()
    """Findings that are no faults."""
    summary_tables: Tables = field(default_factory=dict)
    """The most important numbers, as tables for the person at the terminal."""

    @property
    def tables(self) -> Tables:
        """The most important numbers as tables for a terminal: `summary_tables`."""
        return self.summary_tables

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved beside the motion; see `MotionResult.report`."""
        return {**self.about, **closing_fields(inputs, settings)}

    def __repr__(self) -> str:
        """A summary of at most ten lines: length, person, known facts, and findings."""
        found = [f"repaired: {finding.message}" for finding in self.repairs]
        found += [f"warning: {finding.message}" for finding in self.warnings]
        return in_ten_lines(self._headline(), self.summary, found)


@dataclass(frozen=True, repr=False)
class MotionResults:
    """A sequence of generated motions with one report; returned by `sample` and `predict`."""

    made: tuple[MadeMotion, ...]
    """Each with its motion, joints, contacts and ground."""
    noun: str
    """What one of them is called, in names of files: "sample"."""
    warnings: tuple[Finding, ...] = ()
    """Findings that may make the motions wrong."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """Numbers common to all motions, in plain values."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """The values used for settings that the caller left open."""

    @property
    def tables(self) -> Tables:
        """The tables of the report, one per motion."""
        rows = {f"{self.noun} {k}": one.about for k, one in enumerate(self.made)}
        return {repr(self).splitlines()[0]: rows}

    def __len__(self) -> int:
        """The number of results."""
        return len(self.made)

    def __getitem__(self, index: int) -> MadeMotion:
        """Return the motion with this number."""
        return self.made[index]

    def __iter__(self) -> Iterator[MadeMotion]:
        """Iterates over the results."""
        return iter(self.made)

    def report(
        self,
        out: Path | str,
        inputs: Mapping[str, str] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """The JSON report saved beside the motions, in plain values.

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
        return {
            "files": files,
            "warnings": warnings,
            **self.about,
            **closing_fields(inputs, asked),
        }

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
        output = Output(path, OutputKind.FILE if one else OutputKind.FOLDER)
        said = self.report(path) if report is None else report
        with writing(output, report=said, overwrite=overwrite) as (staged,):
            for name, made in zip(names, self.made, strict=True):
                save_motion(staged if one else staged / name, made.file)

    def __repr__(self) -> str:
        """A summary of at most ten lines: number, lengths, and findings."""
        motion = self.made[0].motion
        first = (
            f"{len(self)} motions ({self.noun}) of {motion.frames} frames, "
            f"{motion.duration:.2f} s at {motion.fps:g} frames per second"
        )
        kept = [one_line(repr(one).splitlines()[0]) for one in self.made]
        found = [f"warning: {finding.message}" for finding in self.warnings]
        return in_ten_lines(first, kept, found)


def file_names(out: Path, count: int, noun: str) -> list[str]:
    """Return the file names for `count` motions: `out` itself, or numbered files in a folder.

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
