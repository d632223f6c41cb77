"""The laboratory report that `recon.report` returns: an offline page and a table."""

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from recon.api.results import in_ten_lines
from recon.core.visible import visible
from recon.formats.outputs import Output, check_outputs
from recon.formats.reports import versions
from recon.formats.writing import writing
from recon.gait.analysis import CURVES, FIGURES, Gait, GaitFigure
from recon.gait.feet import SIDES
from recon.gait.plots import (
    STYLE,
    PointResiduals,
    matplotlib,
    plot_angles,
    plot_cycles,
    plot_residuals,
    plot_steps,
)

_CSS = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 1.5rem auto;
       padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0 0 .3rem; } h2 { font-size: 1.15rem; margin: 1.8rem 0 .5rem; }
dl { display: flex; flex-wrap: wrap; gap: .2rem 1.6rem; margin: 0; }
dt { color: #666; display: inline; } dt::after { content: ": "; }
dd { display: inline; margin: 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .9rem .2rem 0; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } thead th { border-bottom: 1px solid #999; }
.scroll { overflow-x: auto; } svg { width: 100%; min-width: 38rem; height: auto; }
.warnings { background: #fdf0d5; border-left: 4px solid #d98e04; padding: .5rem 1rem; }
.quiet { color: #666; font-size: .9rem; } li { margin: .2rem 0; }
.left { color: #c0392b; } .right { color: #1f6fb2; }
@media print { details { display: none; } h2 { break-after: avoid; } svg { break-inside: avoid; } }
"""
_TURN_RAD = math.radians(20)
"""Turn of the pelvis from one strike to the next from which on a cycle is no straight walking."""
_NO_STEPS = "<p>No foot strikes or leaves the ground.</p>"
_NO_RESIDUALS = "<p>Not known: no report of a conversion or a fit lies beside the motion file.</p>"
_DECIMALS = {"m": 3, "s": 3, "m/s": 2, "steps/min": 1, "% of cycle": 1}


@dataclass(frozen=True, repr=False)
class LaboratoryReport:
    """A report on the gait of one trial, with residuals and findings."""

    title: str
    facts: Mapping[str, str]
    """Facts about the trial in the order in which they are shown: rate, length, stature ..."""
    gait: Gait
    """Events, cycles, spatio-temporal figures and joint angles."""
    residuals: tuple[PointResiduals, ...]
    """Empty where no report of a fit or a conversion is known."""
    warnings: tuple[str, ...]
    """What should be read before any figure is used."""
    repairs: tuple[str, ...]
    """What was wrong with the data and was put right."""
    notes: tuple[str, ...]
    """What is worth knowing but is no fault."""
    decisions: tuple[str, ...]
    """What was read, guessed or cut in reading the recording."""

    def page(self) -> str:
        """The report's page as HTML that needs no network.

        Raises:
            ReconError: when matplotlib is not installed.
        """
        gait = self.gait
        facts = [
            f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in self.facts.items()
        ]
        told = (("Repairs", self.repairs), ("Diagnosis", self.notes))
        with matplotlib().rc_context(STYLE):
            parts = [
                f"<h1>{escape(self.title)}</h1>",
                f"<dl>{''.join(facts)}</dl>",
                _warning_box("<b>Read this first</b>" + _html_list(self.warnings))
                if self.warnings
                else "",
                "<h2>Time and distance</h2>",
                _figures_html(gait),
                "<h2>Gait events</h2>",
                _scroll_box(plot_steps(gait)) if gait.stances else _NO_STEPS,
                _events_html(gait),
                "<h2>Joint angles</h2>",
                _scroll_box(plot_cycles(gait) if gait.cycles else plot_angles(gait)),
                _ranges_html(gait),
                "<h2>Residuals</h2>",
                "" if self.residuals else _NO_RESIDUALS,
                *(
                    f'<p class="quiet">{escape(one.name)}</p>{_scroll_box(plot_residuals(one))}'
                    for one in self.residuals
                ),
                *(f"<h2>{head}</h2>\n{_html_list(lines)}" for head, lines in told if lines),
                _html_details("What was read and decided", _html_list(self.decisions))
                if self.decisions
                else "",
                "<h2>How this was told</h2>",
                _methods_html(gait),
            ]
        body = "\n".join(part for part in parts if part)
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(self.title)}</title><style>{_CSS}</style></head>"
            f"<body>\n{body}\n</body></html>\n"
        )

    def table(self) -> str:
        """The report's table as comma-separated values, a row per number."""
        return table_of(self.gait)

    def save(
        self,
        path: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the page, and the table next to it with the ending .csv.

        Args:
            path: page to write.
            overwrite: replace files that are there and recon did not write.
            report: what stands beside both, in FILE.json, instead of the versions.

        Raises:
            FileExistsError: when a file is there and recon did not write it, unless `overwrite`.
            ValueError: when page and table would have one name, or matplotlib is not installed.
        """
        content = {"versions": versions()} if report is None else report
        outputs = outputs_of(Path(path))
        check_outputs(outputs, overwrite=overwrite)
        page, table = self.page(), self.table()
        with writing(*outputs, report=content, overwrite=overwrite) as staged:
            for file, text in zip(staged, (page, table), strict=True):
                file.write_text(visible(text), encoding="utf-8")

    def __repr__(self) -> str:
        """The most important gait parameters in at most ten lines."""
        gait = self.gait
        first = (
            f"LaboratoryReport: {self.title}, {len(gait.cycles_of('left'))} left and "
            f"{len(gait.cycles_of('right'))} right cycles"
        )
        known = [
            f"{one.name}: {one.mean:.3g} {one.unit}"
            for one in gait.figures
            if one.side == "both" and one.name in ("cadence", "speed", "step length")
        ]
        return in_ten_lines(first, known, [f"warning: {one}" for one in self.warnings])


def outputs_of(page: Path) -> tuple[Output, Output]:
    """Return the two output files of a report: the page, and beside it the table (.csv)."""
    return Output(page), Output(page.with_suffix(".csv"))


def _warning_box(inside: str) -> str:
    """HTML of a highlighted box for findings that matter for the interpretation."""
    return f'<div class="warnings">{inside}</div>'


def _html_list(sentences: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ul>"


def _figures_html(gait: Gait) -> str:
    if len(gait.cycles) == 0:
        return (
            "<p>There is no complete cycle of gait: no foot strikes the ground twice with its "
            "swing between. Angles are drawn along time below.</p>"
        )
    names = list(dict.fromkeys((one.name, one.unit) for one in gait.figures))
    cells = {(one.name, one.side): one for one in gait.figures}
    rows = [
        [
            f"{name} ({unit})",
            *(_figure_as_text(cells.get((name, side))) for side in ("both", *SIDES)),
        ]
        for name, unit in names
    ]
    head = ["", "both sides", "left", "right"]
    turns = sum(abs(cycle.turn) > _TURN_RAD for cycle in gait.cycles)
    turning = (
        f"{turns} of {len(gait.cycles)} cycles turn by more than {math.degrees(_TURN_RAD):.0f}°; "
        "means over straight and turning cycles describe neither."
    )
    caption = (
        '<p class="quiet">Mean ± standard deviation over the cycles, and how many there are. '
        "Double support below zero means that both feet are off the ground.</p>"
    )
    return _html_table(head, rows) + caption + (_warning_box(turning) if turns else "")


def _figure_as_text(figure: GaitFigure | None) -> str:
    if figure is None:
        return "–"
    digits = _DECIMALS[figure.unit]
    spread = "" if figure.std is None else f" ± {figure.std:.{digits}f}"
    return f"{figure.mean:.{digits}f}{spread} ({figure.count})"


def _events_html(gait: Gait) -> str:
    if len(gait.cycles) == 0:
        return ""
    head = [
        "cycle", "strike (s)", "other foot off", "other strike", "foot off", "next strike",
        "length (m)", "speed (m/s)", "turn (°)",
    ]  # fmt: skip
    rows = [
        [
            cycle.side,
            *(
                "–" if moment is None else f"{moment:.3f}"
                for moment in (
                    cycle.strike, cycle.opposite_off, cycle.opposite_strike, cycle.off,
                    cycle.next_strike, cycle.length,
                )
            ),
            f"{cycle.speed:.2f}",
            f"{math.degrees(cycle.turn):.0f}",
        ]
        for cycle in gait.cycles
    ]  # fmt: skip
    return _html_details(f"All {len(rows)} cycles", _html_table(head, rows))


def _ranges_html(gait: Gait) -> str:
    """HTML table of the least and largest value of each mean curve."""
    if len(gait.cycles) == 0:
        return ""
    rows: list[list[str]] = []
    for curve in CURVES:
        row = [curve.title]
        for side in SIDES:
            curves = gait.curves(curve, side)
            if len(curves) == 0:
                row += ["–"] * 3
                continue
            mean = curves.mean(0)
            row += [f"{value:.1f}" for value in (mean.min(), mean.max(), np.ptp(mean))]
        rows.append(row)
    head = [f"{side} {what}" for side in SIDES for what in ("least", "largest", "range")]
    return _html_details("Ranges of the mean curves", _html_table(["degrees", *head], rows))


def _html_details(summary: str, inside: str) -> str:
    return f"<details><summary>{summary}</summary>{inside}</details>"


def _scroll_box(inside: str) -> str:
    """HTML around a drawing or table that scrolls sideways if the page is narrow."""
    return f'<div class="scroll">{inside}</div>'


def _html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    lines = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return _scroll_box(f"<table><thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table>")


def _methods_html(gait: Gait) -> str:
    told = [
        "Steps are found where a heel is farthest ahead of the pelvis, and toes farthest behind, "
        "in the direction that the pelvis faces (Zeni et al. 2008). The foot strikes where its "
        "middle falls fastest (O'Connor et al. 2007); it leaves the ground where its toes become "
        "faster than 0.8 m/s. Between the two it must be in contact with the ground. Paths are "
        "filtered at 12 Hz. The method is for walking forwards; running is less certain.",
        "A cycle goes from one strike of a foot to its next. Lengths are distances between places "
        "where heels stand; step length and width are measured along and across the line of the "
        "stride. Cadence is two steps per stride time.",
        "Joint angles follow the recommendations of the International Society of Biomechanics (Wu "
        "et al. 2002), on the axes of the fitted body; transverse and frontal angles of knees and "
        "ankles are less certain than flexions. Pelvic rotation is relative to the direction of "
        "the stride.",
    ]
    if gait.angle_std:
        told.append("Dotted lines are one standard deviation of the angle in the fit.")
    if gait.belt is not None:
        told.append(
            f"The person walks on a treadmill, whose belt runs at {gait.belt:.2f} m/s; lengths "
            "and speeds are relative to the belt."
        )
    return _html_list(told)


HEADER = ("kind", "name", "side", "cycle", "percent", "time_s", "value", "std", "unit")
"""Columns: kind is figure, event, cycle or angle; cells that do not apply are empty. `std` is over
cycles for figures, and that of the fit for angles."""
Row = tuple[str | int | float | None, ...]


def table_of(gait: Gait) -> str:
    """Return a report's CSV table: gait parameters, events, then every cycle with its angles."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    for rows in (_figure_rows(gait), _event_rows(gait), _cycle_rows(gait), _angle_rows(gait)):
        writer.writerows([_cell_text(value) for value in row] for row in rows)
    return text.getvalue()


def _cell_text(value: str | int | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _figure_rows(gait: Gait) -> Iterator[Row]:
    for one in gait.figures:
        yield "figure", one.name, one.side, None, None, None, one.mean, one.std, one.unit


def _event_rows(gait: Gait) -> Iterator[Row]:
    for one in gait.stances:
        for name, frame in (("foot strike", one.strike), ("foot off", one.off)):
            if frame is not None:
                time = float(gait.times[frame])
                yield "event", name, one.side, None, None, time, None, None, None


def _cycle_rows(gait: Gait) -> Iterator[Row]:
    numbered = [(side, *row) for side in SIDES for row in enumerate(gait.cycles_of(side), 1)]
    for side, number, cycle in numbered:
        values = [(name, unit, factor, value(cycle)) for name, unit, factor, value in FIGURES]
        for name, unit, factor, value in (*values, ("turn", "deg", 180 / np.pi, cycle.turn)):
            scaled = None if value is None else factor * value
            yield "cycle", name, side, number, None, cycle.strike, scaled, None, unit


def _angle_rows(gait: Gait) -> Iterator[Row]:
    for curve in CURVES:
        for side in SIDES:
            curves, std = gait.curves(curve, side), gait.curve_std(curve, side)
            for row, cycle in enumerate(gait.cycles_of(side)):
                for percent, value in enumerate(curves[row].tolist()):
                    time = cycle.strike + percent / 100 * cycle.seconds
                    sure = None if std is None else float(std[row, percent])
                    name = curve.title.removesuffix(" +")
                    yield "angle", name, side, row + 1, percent, time, value, sure, "deg"
