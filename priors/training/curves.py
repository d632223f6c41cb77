"""Losses of a run as a table and as curves, written in one step each."""

from collections.abc import Sequence
from pathlib import Path

from recon.formats.files.opening import replacing


def write_losses(
    folder: Path, rows: Sequence[dict[str, float]], panels: Sequence[Sequence[str]]
) -> None:
    """Write `losses.csv` (one line per row) and `losses.png` (one panel per group of columns).

    Args:
        folder: of the run.
        rows: with equal columns, among them `step`.
        panels: columns drawn together, on a logarithmic scale.
    """
    columns = list(rows[0])
    lines = [",".join(columns)]
    lines += [",".join(f"{row[column]:.6g}" for column in columns) for row in rows]
    with replacing(folder / "losses.csv") as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")
    _draw(rows, panels, folder / "losses.png")


def _draw(rows: Sequence[dict[str, float]], panels: Sequence[Sequence[str]], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, names in zip(figure.subplots(1, len(panels)), panels, strict=True):
        for name in names:
            axes.plot([row["step"] for row in rows], [row[name] for row in rows], label=name)
        axes.set_yscale("log")
        axes.set_xlabel("step")
        axes.legend()
    with replacing(path) as beside:
        figure.savefig(beside, format="png", dpi=100)
