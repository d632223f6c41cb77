"""Draws the plots of a laboratory report as SVG with matplotlib."""

import io
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from importlib import import_module
from typing import Any

import numpy as np

from recon.core.errors import optional_module
from recon.core.visible import visible
from recon.gait.analysis import CURVES, PERCENT, Gait, GaitCurve
from recon.gait.feet import SIDES


@dataclass(frozen=True)
class PointResiduals:
    """Residuals of each point of one sensor, in the sensor's unit."""

    name: str
    """The observation, as its report names it."""
    unit: str
    values: Mapping[str, float]
    """Median or mean distance of every point, by its name."""
    measure: str
    """What the values are, for the axis of the plot."""


COLOURS = {"left": "#c0392b", "right": "#1f6fb2"}
"""Colours of the sides, which readers with colour blindness tell apart, too."""
GREY = "#777777"
STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.7,
    "xtick.color": GREY,
    "ytick.color": GREY,
}
"""Settings of matplotlib while a page is drawn."""
MAX_POINTS = 60
"""Points whose residuals are drawn; of more, the largest."""


def matplotlib() -> Any:
    """Import matplotlib, or raise an error that says how to install it.

    Raises:
        ReconError: when it is not installed.
    """
    return optional_module("matplotlib", "matplotlib", "drawing the plots of a report", "report")


def plot_steps(gait: Gait) -> str:
    """Plot the stances of both feet over time as bars from strike to toe-off."""
    figure = _figure(1.7)
    axes = figure.subplots()
    first, last = float(gait.times[0]), float(gait.times[-1])
    for row, side in enumerate(reversed(SIDES)):
        for one in gait.stances:
            if one.side != side:
                continue
            begin = first if one.strike is None else float(gait.times[one.strike])
            end = last if one.off is None else float(gait.times[one.off])
            axes.barh(row, end - begin, left=begin, height=0.5, color=COLOURS[side])
            if one.strike is not None:
                axes.plot([begin, begin], [row - 0.38, row + 0.38], color="black", lw=1.2)
            if one.off is not None:
                axes.plot(end, row + 0.38, "^", color="black", ms=4)
    axes.set_yticks([0, 1], list(reversed(SIDES)))
    axes.set_xlim(first, last)
    axes.set_ylim(-0.6, 1.7)
    axes.set_xlabel("time (s)")
    axes.set_title("stances: | foot strike, ▲ foot off", loc="left")
    return _svg_text(figure, "steps")


def plot_cycles(gait: Gait) -> str:
    """Plot joint angles over the cycle: every cycle, means and standard deviations."""
    figure = _panels_of_angles(gait, _draw_over_cycle, "cycle (%)")
    drawn = [zip(*axes.get_legend_handles_labels(), strict=True) for axes in figure.axes]
    marks = {word: mark for panel in reversed(drawn) for mark, word in panel}
    figure.legend(
        marks.values(), marks, loc="outside upper center", ncols=len(marks), frameon=False
    )
    return _svg_text(figure, "cycles")


def plot_angles(gait: Gait) -> str:
    """Plot joint angles over time, for motions without cycles of gait."""
    return _svg_text(_panels_of_angles(gait, _draw_over_time, "time (s)"), "angles")


def plot_residuals(found: PointResiduals) -> str:
    """Plot the residuals of one sensor, the largest first."""
    rows = sorted(found.values.items(), key=lambda row: -row[1])[:MAX_POINTS]
    figure = _figure(2.6)
    axes = figure.subplots()
    names = [visible(name).replace("$", r"\$") for name, _ in rows]  # no formulas
    axes.bar(names, [value for _, value in rows], color="#5b7f95")
    axes.set_ylabel(f"{found.measure} ({found.unit})")
    axes.tick_params(axis="x", labelrotation=90, labelsize=7)
    axes.margins(x=0.01)
    return _svg_text(figure, f"residuals of {found.name}")


def _panels_of_angles(
    gait: Gait, draw_panel: Callable[[Any, Gait, GaitCurve], None], x_label: str
) -> Any:
    """Draw a matplotlib figure with one panel for each joint angle, three in a row."""
    figure = _figure(10.0)
    grid = figure.subplots((len(CURVES) + 2) // 3, 3, sharex=True)
    for axes, curve in zip(grid.flat, CURVES, strict=True):
        draw_panel(axes, gait, curve)
    for axes in grid[-1]:
        axes.set_xlabel(x_label)
    for axes in grid[:, 0]:
        axes.set_ylabel("degrees")
    return figure


def _draw_over_time(axes: Any, gait: Gait, curve: GaitCurve) -> None:
    for side in SIDES if curve.sided else SIDES[:1]:
        colour = COLOURS[side] if curve.sided else "black"
        axes.plot(gait.times, gait.angles[curve.angle(side)], color=colour, lw=1.0)
    # curves not split into left and right are titled by what is positive: trunk left rotation +
    title = curve.title if curve.sided else f"{curve.name.replace('_', ' ')} +"
    axes.set_title(title, loc="left")


def _draw_over_cycle(axes: Any, gait: Gait, curve: GaitCurve) -> None:
    percent = np.arange(PERCENT)
    title = curve.title
    for side in SIDES:
        curves, colour = gait.curves(curve, side), COLOURS[side]
        if len(curves) == 0:
            continue
        axes.plot(percent, curves.T, color=colour, lw=0.4, alpha=0.5)
        mean = curves.mean(0)
        axes.plot(percent, mean, color=colour, lw=1.6, label=f"{side}: mean of {len(curves)}")
        if len(curves) > 1:
            std = curves.std(0, ddof=1)
            style = {"color": colour, "alpha": 0.2, "lw": 0, "label": "± 1 SD over cycles"}
            axes.fill_between(percent, mean - std, mean + std, **style)
        known = gait.curve_std(curve, side)
        if known is not None:
            std = np.sqrt(np.square(known).mean(0))
            style = {"color": colour, "lw": 0.7, "ls": ":", "label": "± 1 SD of the fit"}
            axes.plot(percent, np.stack([mean - std, mean + std], 1), **style)
        off = float(np.mean([cycle.stance for cycle in gait.cycles_of(side)]))
        axes.axvline(100 * off, color=colour, lw=0.7, ls="--", label="mean foot off")
        if gait.unseen.get(curve.angle(side), 0.0) > 0.5:
            title = f"{curve.title} (inferred)"
    axes.axhline(0, color=GREY, lw=0.5)
    axes.set_xlim(0, 100)
    axes.set_title(title, loc="left")


def _figure(height: float) -> Any:
    """An empty figure as wide as a page; height in inches."""
    figures = import_module("matplotlib.figure")
    return figures.Figure(figsize=(9.0, height), layout="constrained")


def _svg_text(figure: Any, name: str) -> str:
    """Return a figure as the text of an SVG element; equal figures give equal text."""
    text = io.StringIO()
    # ids inside the SVGs of one page must differ, which the salt ensures
    with matplotlib().rc_context({"svg.hashsalt": name}):
        figure.savefig(text, format="svg", metadata={"Date": None}, transparent=True)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    return re.sub(r'<svg ([^>]*?)width="[^"]*"', r"<svg \1", svg, count=1).replace(
        "<svg ", f'<svg role="img" aria-label="{escape(visible(name))}" ', 1
    )
