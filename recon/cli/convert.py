"""`recon convert`: any mocap recording onto the body."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from recon.cli.errors import Failed


def convert(
    recording: Positional[Path],
    out: Positional[Path],
    everything: Annotated[bool, arg(name="all")] = False,
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None,
    up: Literal["x", "y", "z"] | None = None,
    mapping: Path | None = None,
    fps: float | None = None,
    body: Path | None = None,
    processes: int = 2,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
) -> None:
    """Bring a recording (.bvh, .amc, .c3d, .trc, .mat, also .xz and FILE::MEMBER) onto the body.

    With --all, RECORDING is a folder and OUT another: every skeleton recording below it is
    converted in parallel, one shape per subject, with a report; run it again to continue.

    Args:
        recording: file, or folder with --all.
        out: motion file to write, or folder with --all.
        everything: convert a whole folder.
        unit: of the file; default: found out.
        up: axis that points up; default: found out.
        mapping: TOML file that says which joints or markers are which.
        fps: rate of the result; default: the recording's.
        body: a SMPL-family file of your own; default: the bundled body.
        processes: clips at a time with --all.
        json: print the report as JSON on stdout.
    """
    from recon.cli import console

    if everything:
        if any(option is not None for option in (unit, up, mapping, fps)):
            raise ValueError("--all takes unit, axis and rate from each file; leave them out")
        _convert_folder(recording, out, body, processes, json)
        return

    from recon.body import BodyModel
    from recon.ingest import convert as convert_one

    model = BodyModel.load(body)
    found = convert_one(str(recording), model, unit=unit, up=up, mapping=mapping, fps=fps)
    out.parent.mkdir(parents=True, exist_ok=True)
    found.save(out, model)
    for decision in found.decisions:
        console.say(f"  {decision}")
    rows = {key: {"value": value} for key, value in found.report.items()}
    console.table(str(out), rows)
    if json:
        residuals = {name: round(value, 2) for name, value in found.residuals.items()}
        decisions = list(found.decisions)
        console.answer({**found.report, "decisions": decisions, "residuals_mm": residuals})


def _convert_folder(
    folder: Path, out: Path, body: Path | None, processes: int, json: bool
) -> None:
    from statistics import median

    from recon.cli import console
    from recon.ingest.corpus import convert_corpus

    rows = convert_corpus(folder, out, processes=processes, body=body)
    kept = [row for row in rows if row.get("kept")]
    summary = {
        "clips": len(rows),
        "converted": len(kept),
        "rejected": len(rows) - len(kept),
        "minutes": round(sum(float(row["seconds"] or 0) for row in kept) / 60, 2),
        "median_residual_mm": median(float(row["residual_mm"] or 0) for row in kept)
        if kept
        else 0,
        "report": str(out / "report.csv"),
    }
    console.table(str(out), {key: {"value": value} for key, value in summary.items()})
    if json:
        console.answer(summary)
    if not kept:
        raise Failed(f"{folder}: no recording could be converted; see {out / 'report.csv'}")
