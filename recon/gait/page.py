"""A laboratory report as one page of HTML that needs no network and prints well."""

import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from recon.formats.outputs import Output
from recon.gait.analysis import CURVES, Gait, GaitFigure
from recon.gait.plots import (
    LaboratoryContents,
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
_TURN = math.radians(20)
"""Turn of the pelvis from one strike to the next from which on a cycle is no straight walking."""
_DECIMALS = {"m": 3, "s": 3, "m/s": 2, "steps/min": 1, "% of cycle": 1}


def page_of(contents: LaboratoryContents) -> str:
    """The text of the page."""
    gait = contents.gait
    parts = [
        f"<h1>{escape(contents.title)}</h1>",
        _facts(contents),
        _warnings(contents.warnings),
        "<h2>Time and distance</h2>",
        _figures(gait),
        "<h2>Gait events</h2>",
        _plot(plot_steps(gait))
        if gait.stances
        else "<p>No foot strikes or leaves the ground.</p>",
        _events(gait),
        "<h2>Joint angles</h2>",
        _plot(plot_cycles(gait) if gait.cycles else plot_angles(gait)),
        _ranges(gait),
        "<h2>Residuals</h2>",
        *_residuals(contents),
        *_findings("Repairs", contents.repairs),
        *_findings("Diagnosis", contents.notes),
        _decisions(contents.decisions),
        "<h2>How this was told</h2>",
        _methods(gait),
    ]
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(contents.title)}</title><style>{_CSS}</style></head>"
        f"<body>\n{body}\n</body></html>\n"
    )


def _facts(contents: LaboratoryContents) -> str:
    rows = (
        f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in contents.facts.items()
    )
    return f"<dl>{''.join(rows)}</dl>"


def _warnings(warnings: Sequence[str]) -> str:
    if len(warnings) == 0:
        return ""
    return f'<div class="warnings"><b>Read this first</b>{_listed(warnings)}</div>'


def _listed(sentences: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ul>"


def _figures(gait: Gait) -> str:
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
            *(_cell(cells.get((name, side))) for side in ("both", "left", "right")),
        ]
        for name, unit in names
    ]
    head = ["", "both sides", "left", "right"]
    caption = (
        '<p class="quiet">Mean ± standard deviation over the cycles, and how many there are. '
        "Double support below zero means that both feet are off the ground.</p>"
    )
    return _table(head, rows) + caption + _turning(gait)


def _turning(gait: Gait) -> str:
    """What is said where some of the cycles are turns, which averages of walking leave out."""
    turns = sum(abs(cycle.turn) > _TURN for cycle in gait.cycles)
    if turns == 0:
        return ""
    return (
        f'<p class="warnings">{turns} of {len(gait.cycles)} cycles turn by more than '
        f"{math.degrees(_TURN):.0f}°; means over straight and turning cycles describe neither.</p>"
    )


def _cell(figure: GaitFigure | None) -> str:
    if figure is None:
        return "–"
    digits = _DECIMALS[figure.unit]
    spread = "" if figure.std is None else f" ± {figure.std:.{digits}f}"
    return f"{figure.mean:.{digits}f}{spread} ({figure.count})"


def _events(gait: Gait) -> str:
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
    return f"<details><summary>All {len(rows)} cycles</summary>{_table(head, rows)}</details>"


def _ranges(gait: Gait) -> str:
    """Least and largest value of the mean curves."""
    rows: list[list[str]] = []
    for curve in CURVES:
        row = [curve.title]
        for side in ("left", "right"):
            curves = gait.curves(curve, side)
            mean = curves.mean(0) if len(curves) > 0 else None
            row += (
                ["–"] * 3
                if mean is None
                else [f"{mean.min():.1f}", f"{mean.max():.1f}", f"{mean.max() - mean.min():.1f}"]
            )
        rows.append(row)
    if len(gait.cycles) == 0:
        return ""
    head = ["degrees", *(f"{side} {what}" for side in ("left", "right") for what in
                         ("least", "largest", "range"))]  # fmt: skip
    return f"<details><summary>Ranges of the mean curves</summary>{_table(head, rows)}</details>"


def _residuals(contents: LaboratoryContents) -> list[str]:
    if len(contents.residuals) == 0:
        return [
            "<p>Not known: no report of a conversion or a fit lies beside the motion file.</p>"
        ]
    return [
        f'<p class="quiet">{escape(one.name)}</p>{_plot(plot_residuals(one))}'
        for one in contents.residuals
    ]


def _findings(title: str, sentences: Sequence[str]) -> list[str]:
    return [f"<h2>{title}</h2>", _listed(sentences)] if len(sentences) > 0 else []


def _decisions(sentences: Sequence[str]) -> str:
    if len(sentences) == 0:
        return ""
    return f"<details><summary>What was read and decided</summary>{_listed(sentences)}</details>"


def _plot(svg: str) -> str:
    """A drawing that keeps legible on a phone, where it is wider than the page."""
    return f'<div class="scroll">{svg}</div>'


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    lines = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return (
        f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table>'
        "</div>"
    )


def _methods(gait: Gait) -> str:
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
        told.append(
            "Dotted lines are one standard deviation of the fit, propagated from those of the "
            "joints for knees and ankles only; joints are taken as independent, so it is rather "
            "too large."
        )
    if gait.belt is not None:
        told.append(
            f"The person walks on a treadmill, whose belt runs at {gait.belt:.2f} m/s; lengths "
            "and speeds are relative to the belt."
        )
    return _listed(told)


def outputs_of(page: Path) -> tuple[Output, Output]:
    """The page and the table beside it, whose name ends in .csv instead."""
    return Output(page), Output(page.with_suffix(".csv"))
