"""Writes the table of a laboratory report, one number per row."""

import csv
import io
from collections.abc import Iterator

import numpy as np

from recon.gait.analysis import CURVES, FIGURES, Gait
from recon.gait.feet import SIDES

HEADER = ("kind", "name", "side", "cycle", "percent", "time_s", "value", "std", "unit")
"""Columns: kind is figure, event, cycle or angle; cells that do not apply are empty. `std` is over
cycles for figures, and that of the fit for angles."""
Row = tuple[str | int | float | None, ...]


def table_of(gait: Gait) -> str:
    """The table as text: gait parameters, events, then every cycle and its angles."""
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
            told = None if value is None else factor * value
            yield "cycle", name, side, number, None, cycle.strike, told, None, unit


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
