"""A laboratory report, as `recon.report` returns it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.api.results.printing import in_ten_lines
from recon.formats.results.outputs import check_outputs
from recon.formats.results.reports import versions
from recon.formats.results.writing import writing
from recon.metrics.gait.analysis import Gait
from recon.view.laboratory.contents import LaboratoryContents
from recon.view.laboratory.files import outputs_of

_SHOWN = ("cadence", "speed", "step length")
"""Figures that are printed."""


@dataclass(frozen=True, repr=False)
class LaboratoryReport:
    """The gait of one trial with residuals and findings, to look at and to save."""

    contents: LaboratoryContents
    """What the page says."""

    @property
    def gait(self) -> Gait:
        """Events, cycles, spatio-temporal figures and joint angles."""
        return self.contents.gait

    def page(self) -> str:
        """The text of the page: HTML that needs no network.

        Raises:
            ReconError: when matplotlib is not installed.
        """
        from recon.view.laboratory.page import page_of
        from recon.view.laboratory.plots import require_matplotlib

        require_matplotlib()
        return page_of(self.contents)

    def table(self) -> str:
        """The text of the table: comma-separated values, a row per number."""
        from recon.view.laboratory.table import table_of

        return table_of(self.gait)

    def save(
        self,
        path: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the page, and beside it the table, whose name ends in .csv instead.

        Args:
            path: page to write.
            overwrite: replace files that are there and recon did not write.
            report: what stands beside both, in FILE.json, instead of the versions.

        Raises:
            FileExistsError: when a file is there and recon did not write it, unless `overwrite`.
            ValueError: when page and table would have one name, or matplotlib is not installed.
        """
        said = {"versions": versions()} if report is None else report
        outputs = outputs_of(Path(path))
        check_outputs(outputs, overwrite=overwrite)
        page, table = self.page(), self.table()
        with writing(*outputs, report=said, overwrite=overwrite) as staged:
            for file, text in zip(staged, (page, table), strict=True):
                file.write_text(text, encoding="utf-8")

    def __repr__(self) -> str:
        """The most important figures in at most ten lines."""
        gait = self.gait
        first = (
            f"LaboratoryReport: {self.contents.title}, {len(gait.cycles_of('left'))} left and "
            f"{len(gait.cycles_of('right'))} right cycles"
        )
        known = [
            f"{one.name}: {one.mean:.3g} {one.unit}"
            for one in gait.figures
            if one.side == "both" and one.name in _SHOWN
        ]
        return in_ten_lines(first, known, [f"warning: {one}" for one in self.contents.warnings])
