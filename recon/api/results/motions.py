"""Several motions that were made together, as `recon.sample` and `recon.predict` return them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.api.results.motion import Made
from recon.api.results.printing import in_ten_lines, one_line
from recon.core.errors import ReconError
from recon.diagnosis.findings import Finding
from recon.formats.motions import save_motion
from recon.formats.results.outputs import Kind, Output
from recon.formats.results.reports import versions
from recon.formats.results.writing import writing


@dataclass(frozen=True, repr=False)
class MotionResults:
    """Motions in a row: indexed, counted and walked through as a tuple of results is."""

    made: tuple[Made, ...]
    """Each with its motion, joints, contacts and ground."""
    noun: str
    """What one of them is called, in names of files: "sample"."""
    warnings: tuple[Finding, ...] = ()
    """What should be read before they are used."""

    def __len__(self) -> int:
        """How many they are."""
        return len(self.made)

    def __getitem__(self, index: int) -> Made:
        """One of them."""
        return self.made[index]

    def __iter__(self) -> Iterator[Made]:
        """One after the other."""
        return iter(self.made)

    def report(self, out: Path | str) -> dict[str, Any]:
        """What is written beside them, in plain values.

        Args:
            out: where they are written, as `save` takes it.
        """
        path = Path(out)
        names = file_names(path, len(self), self.noun)
        paths = [path] if path.suffix == ".npz" else [path / name for name in names]
        files = {str(p): dict(one.about) for p, one in zip(paths, self.made, strict=True)}
        warnings = [finding.message for finding in self.warnings]
        return {"files": files, "warnings": warnings, "versions": versions()}

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


def file_names(out: Path, count: int, noun: str) -> list[str]:
    """Names of files: of one, or of several in a folder.

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
