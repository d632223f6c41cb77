"""Plots of a laboratory report as SVG, drawn by matplotlib, which is imported only here."""

import io
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.core.errors import ReconError
from recon.gait.analysis import CURVES, Gait, GaitCurve
from recon.gait.feet import SIDES, Side


@dataclass(frozen=True)
class PointResiduals:
    """Residuals of one source of data by the point that they belong to."""

    name: str
    """The observation, as its report names it."""
    unit: str
    values: Mapping[str, float]
    """Median or mean distance of every point, by its name."""
    measure: str
    """What the values are, for the axis of the plot."""


@dataclass(frozen=True)
class LaboratoryContents:
    """One trial: its gait and everything that is known about how good the motion is."""

    title: str
    facts: Mapping[str, str]
    """Facts about the trial in the order in which they are shown: rate, length, stature ..."""
    gait: Gait
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


COLOURS = {"left": "#c0392b", "right": "#1f6fb2"}
"""Colours of the sides, which readers with colour blindness tell apart, too."""
_GREY = "#777777"
_STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _GREY,
    "axes.linewidth": 0.7,
    "xtick.color": _GREY,
    "ytick.color": _GREY,
}
_MOST_POINTS = 60
"""Points whose residuals are drawn; of more, the largest."""


def require_matplotlib() -> None:
    """Refuse to begin where matplotlib is missing.

    Raises:
        ReconError: saying what to install.
    """
    try:
        import_module("matplotlib")
    except ImportError as error:
        raise ReconError(
            "the plots of a report are drawn by matplotlib, which is not installed: "
            "pip install 'motion-recon[report]'"
        ) from error


def plot_steps(gait: Gait) -> str:
    """Stances of both feet along time: bars from strike to off."""

    def draw(figure: Any) -> None:
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

    return _svg(draw, (9.0, 1.7), "steps")


def plot_cycles(gait: Gait) -> str:
    """Joint angles over the cycle: every cycle, mean and bands of both sides."""

    def draw(figure: Any) -> None:
        grid = figure.subplots((len(CURVES) + 2) // 3, 3, sharex=True)
        for axes, curve in zip(grid.flat, CURVES, strict=True):
            _panel(axes, gait, curve)
        for axes in grid[-1]:
            axes.set_xlabel("cycle (%)")
        for axes in grid[:, 0]:
            axes.set_ylabel("degrees")
        _legend(figure, gait)

    return _svg(draw, (9.0, 10.0), "cycles")


def plot_angles(gait: Gait) -> str:
    """Joint angles along time, for motions without cycles of gait."""

    def draw(figure: Any) -> None:
        grid = figure.subplots((len(CURVES) + 2) // 3, 3, sharex=True)
        for axes, curve in zip(grid.flat, CURVES, strict=True):
            for side in _sides(curve):
                colour = COLOURS[side] if curve.sided else "black"
                axes.plot(gait.times, gait.angles[curve.angle(side)], color=colour, lw=1.0)
            axes.set_title(_unmirrored(curve), loc="left")
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
        for axes in grid[:, 0]:
            axes.set_ylabel("degrees")

    return _svg(draw, (9.0, 10.0), "angles")


def plot_residuals(found: PointResiduals) -> str:
    """Residuals of one source of data, the largest first."""
    rows = sorted(found.values.items(), key=lambda row: -row[1])[:_MOST_POINTS]

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        axes.bar([name for name, _ in rows], [value for _, value in rows], color="#5b7f95")
        axes.set_ylabel(f"{found.measure} ({found.unit})")
        axes.tick_params(axis="x", labelrotation=90, labelsize=7)
        axes.margins(x=0.01)

    return _svg(draw, (9.0, 2.6), f"residuals of {found.name}")


def _sides(curve: GaitCurve) -> tuple[Side, ...]:
    return ("left", "right") if curve.sided else ("left",)


def _unmirrored(curve: GaitCurve) -> str:
    """Title of an angle whose sign is that of its name."""
    return curve.title if curve.sided else f"{curve.name.replace('_', ' ')} +"


def _panel(axes: Any, gait: Gait, curve: GaitCurve) -> None:
    percent = np.arange(101)
    title = curve.title
    for side in ("left", "right"):
        curves = gait.curves(curve, side)
        if len(curves) == 0:
            continue
        for one in curves:
            axes.plot(percent, one, color=COLOURS[side], lw=0.4, alpha=0.5)
        mean = curves.mean(0)
        axes.plot(percent, mean, color=COLOURS[side], lw=1.6)
        if len(curves) > 1:
            _band(axes, mean, curves.std(0, ddof=1), color=COLOURS[side], alpha=0.2, lw=0)
        known = gait.curve_std(curve, side)
        if known is not None:
            std = np.sqrt(np.square(known).mean(0))
            for sign in (-1, 1):
                axes.plot(percent, mean + sign * std, color=COLOURS[side], lw=0.7, ls=":")
        off = float(np.mean([cycle.stance for cycle in gait.cycles_of(side)]))
        axes.axvline(100 * off, color=COLOURS[side], lw=0.7, ls="--")
        if gait.unseen.get(curve.angle(side), 0.0) > 0.5:
            title = f"{curve.title} (inferred)"
    axes.axhline(0, color=_GREY, lw=0.5)
    axes.set_xlim(0, 100)
    axes.set_title(title, loc="left")


def _band(
    axes: Any,
    mean: Float[np.ndarray, " percent"],
    std: Float[np.ndarray, " percent"],
    **style: Any,
) -> None:
    axes.fill_between(np.arange(101), mean - std, mean + std, **style)


def _legend(figure: Any, gait: Gait) -> None:
    lines = import_module("matplotlib.lines")
    patches = import_module("matplotlib.patches")
    marks = [
        lines.Line2D([], [], color=COLOURS[side], lw=1.6, label=f"{side}: mean of {count}")
        for side in ("left", "right")
        if (count := len(gait.cycles_of(side))) > 0
    ]
    marks.append(patches.Patch(color=_GREY, alpha=0.3, label="± 1 SD over cycles"))
    if gait.angle_std:
        marks.append(lines.Line2D([], [], color=_GREY, lw=0.7, ls=":", label="± 1 SD of the fit"))
    marks.append(lines.Line2D([], [], color=_GREY, lw=0.7, ls="--", label="mean foot off"))
    figure.legend(handles=marks, loc="outside upper center", ncols=len(marks), frameon=False)


def _svg(draw: Callable[[Any], None], size: tuple[float, float], name: str) -> str:
    """The text of a drawing as an element of a page; the same drawing is the same text."""
    matplotlib = import_module("matplotlib")
    text = io.StringIO()
    # the hash names what a drawing defines, which must differ between drawings of one page
    with matplotlib.rc_context({**_STYLE, "svg.hashsalt": name}):
        figure = import_module("matplotlib.figure").Figure(figsize=size, layout="constrained")
        draw(figure)
        figure.savefig(text, format="svg", metadata={"Date": None}, transparent=True)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    return re.sub(r'<svg ([^>]*?)width="[^"]*"', r"<svg \1", svg, count=1).replace(
        "<svg ", f'<svg role="img" aria-label="{name}" ', 1
    )
