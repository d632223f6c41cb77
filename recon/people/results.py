"""The result of `recon.fit_people`: the fits of several people in one recording."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from recon.api.result import Result
from recon.api.results import in_ten_lines, one_line
from recon.diagnosis.findings import Finding
from recon.formats.motions import save_motion
from recon.formats.outputs import Output, OutputKind
from recon.formats.reports import versions
from recon.formats.writing import writing


@dataclass(frozen=True, repr=False)
class People:
    """A sequence of fit results, one per person in a recording."""

    results: tuple[Result, ...]
    numbers: tuple[int, ...]
    """Numbers of the people, as `--person` takes them."""
    camera_shared: bool
    """Whether all are in one world, with one camera and one ground that were found together."""
    notes: tuple[str, ...] = ()
    """What was decided about files, people and the camera."""

    def __len__(self) -> int:
        """The number of results."""
        return len(self.results)

    def __getitem__(self, index: int) -> Result:
        """The result at a position of the sequence (not by person number)."""
        return self.results[index]

    def __iter__(self) -> Iterator[Result]:
        """Iterates over the results."""
        return iter(self.results)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """All warnings, each with the number of its person."""
        return self._findings("warnings")

    @property
    def failed(self) -> bool:
        """Whether the fit of at least one person met NaN or infinity."""
        return any(one.failed for one in self.results)

    @property
    def tables(self) -> dict[str, dict[str, dict[str, Any]]]:
        """The summary as tables for a terminal."""
        return {"people": self.summary()}

    def summary(self) -> dict[str, dict[str, Any]]:
        """Every person's time span, height, residuals and number of warnings, by file name."""
        out: dict[str, dict[str, Any]] = {}
        for name, one in zip(self._names(), self.results, strict=True):
            motion = one.motion
            end = motion.stop_time
            residuals = ", ".join(f"{r.median:.3g} {r.unit}" for r in one.residuals)
            out[name] = {
                "from s": round(motion.start_time, 3),
                "to s": round(end, 3),
                "height m": round(float(one.body.height(motion.shape)), 2),
                "residual": residuals,
                "warnings": len(one.warnings),
            }
        return out

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved with the motions, in plain values.

        Args:
            inputs: SHA-256 of the files that were read, by path; none by default.
            settings: of the fits, by name; by default their arguments.
        """
        every = zip(self._names(), self.results, strict=True)
        return {
            "people": {name: one.report(inputs, settings) for name, one in every},
            "summary": self.summary(),
            "camera_shared": self.camera_shared,
            "read": list(self.notes),
            "failed": self.failed,
            "diagnosis": [finding.report() for finding in self._findings("diagnosis")],
            "repairs": [finding.report() for finding in self._findings("repairs")],
            "warnings": [finding.report() for finding in self.warnings],
            "versions": versions(),
        }

    def save(
        self,
        folder: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a folder of `person_0.npz` and so on, and the report, `report.json`.

        Args:
            folder: to write; it has afterwards what was written to it now.
            overwrite: replace what is there and recon did not write.
            report: what to write instead of `report()`.

        Raises:
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
        """
        output = Output(Path(folder), OutputKind.FOLDER)
        with writing(output, report=report or self.report(), overwrite=overwrite) as (staged,):
            for name, one in zip(self._names(), self.results, strict=True):
                save_motion(staged / name, one.file)

    def __repr__(self) -> str:
        """A summary of at most ten lines: number of people and findings."""
        first = f"{len(self)} people" + (", one camera and ground" if self.camera_shared else "")
        every = zip(self.numbers, self.results, strict=True)
        kept = [f"person {n}: {one_line(repr(one).splitlines()[0])}" for n, one in every]
        found = [f"warning: {finding.message}" for finding in self.warnings]
        return in_ten_lines(first, kept, found)

    def _names(self) -> list[str]:
        return [f"person_{number}.npz" for number in self.numbers]

    def _findings(self, kind: str) -> tuple[Finding, ...]:
        return tuple(
            replace(finding, message=f"person {number}: {finding.message}")
            for number, one in zip(self.numbers, self.results, strict=True)
            for finding in getattr(one, kind)
        )
