"""A laboratory report, as `recon.report` returns it."""

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.api.results import in_ten_lines
from recon.formats.outputs import check_outputs
from recon.formats.reports import versions
from recon.formats.writing import writing
from recon.gait.analysis import CURVES, Gait, GaitCycle
from recon.gait.feet import Side
from recon.gait.page import outputs_of
from recon.gait.plots import LaboratoryContents

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
        from recon.gait.page import page_of
        from recon.gait.plots import require_matplotlib

        require_matplotlib()
        return page_of(self.contents)

    def table(self) -> str:
        """The text of the table: comma-separated values, a row per number."""
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


HEADER = ("kind", "name", "side", "cycle", "percent", "time_s", "value", "std", "unit")
"""Columns: kind is figure, event, cycle or angle; cells that do not apply are empty. `std` is over
cycles for figures, and that of the fit for angles."""
Row = tuple[str | int | float | None, ...]


def table_of(gait: Gait) -> str:
    """The text of the table: figures, then events, then every cycle and its angles."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    for rows in (_figures(gait), _events(gait), _cycles(gait), _angles(gait)):
        writer.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _cell(value: str | int | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _figures(gait: Gait) -> Iterator[Row]:
    for one in gait.figures:
        yield "figure", one.name, one.side, None, None, None, one.mean, one.std, one.unit


def _events(gait: Gait) -> Iterator[Row]:
    for one in gait.stances:
        for name, frame in (("foot strike", one.strike), ("foot off", one.off)):
            if frame is not None:
                time = float(gait.times[frame])
                yield "event", name, one.side, None, None, time, None, None, None


def _cycles(gait: Gait) -> Iterator[Row]:
    for side, number, cycle in _numbered(gait):
        for name, value, unit in (
            ("stride time", cycle.seconds, "s"),
            ("stride length", cycle.length, "m"),
            ("step length", cycle.step_length, "m"),
            ("step width", cycle.step_width, "m"),
            ("speed", cycle.speed, "m/s"),
            ("stance", 100 * cycle.stance, "% of cycle"),
            ("turn", float(np.rad2deg(cycle.turn)), "deg"),
        ):
            yield "cycle", name, side, number, None, cycle.strike, value, None, unit


def _angles(gait: Gait) -> Iterator[Row]:
    for curve in CURVES:
        sides: tuple[Side, ...] = ("left", "right")
        for side in sides:
            curves, std = gait.curves(curve, side), gait.curve_std(curve, side)
            for row, cycle in enumerate(gait.cycles_of(side)):
                for percent, value in enumerate(curves[row].tolist()):
                    time = cycle.strike + percent / 100 * cycle.seconds
                    sure = None if std is None else float(std[row, percent])
                    name = curve.title.removesuffix(" +")
                    yield "angle", name, side, row + 1, percent, time, value, sure, "deg"


def _numbered(gait: Gait) -> Iterator[tuple[Side, int, GaitCycle]]:
    sides: tuple[Side, ...] = ("left", "right")
    for side in sides:
        for number, cycle in enumerate(gait.cycles_of(side), 1):
            yield side, number, cycle
