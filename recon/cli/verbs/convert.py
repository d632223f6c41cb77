"""`recon convert`: any mocap recording onto the body."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from recon.cli.errors import Failed
from recon.cli.places import Arguments, Overwrite, Place, Quiet, writes
from recon.formats.outputs import Kind, Output


def _is_former(folder: Path) -> bool:
    """Whether a folder has the report of a conversion: a list with a row for every clip."""
    import json

    try:
        rows = json.loads((folder / "report.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(rows, list) and all(isinstance(row, dict) and "clip" in row for row in rows)


def _motion_or_folder(out: Path, given: Arguments) -> tuple[Output, ...]:
    if not given["everything"]:
        return (Output(out),)
    # what is written is no recording, so it may lie among them
    return (Output(out, Kind.CONTINUED, inside_input=True, is_former=_is_former),)


@writes(Place("out", _motion_or_folder))
def convert(
    recording: Positional[Path],
    out: Positional[Path],
    everything: Annotated[bool, arg(name="all")] = False,
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None,
    up: Literal["x", "y", "z"] | None = None,
    mapping: Path | None = None,
    fps: float | None = None,
    body: Path | None = None,
    keep_frame: Annotated[
        bool, arg(help="Leave the motion where the laboratory has it, not on z = 0.")
    ] = False,
    processes: int = 2,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Bring a recording (.bvh, .amc, .c3d, .trc, .mat, also .xz and FILE::MEMBER) onto the body.

    With --all, RECORDING is a folder and OUT another: every skeleton recording below it is
    converted in parallel, one shape per subject, with a report; run it again to continue. Exit
    code 1 says that something went wrong with some; those that are too short or of an unknown
    skeleton are rejected, which is in the report alone.

    Writes OUT (AMASS .npz with joints, contacts and ground) and OUT.json (what happened).

    Args:
        recording: file, or folder with --all.
        out: motion file to write, or folder with --all.
        everything: convert a whole folder.
        unit: of the file; default: found out.
        up: axis that points up; default: found out.
        mapping: JSON or TOML file that says which joints or markers are which.
        fps: rate of the result; default: the recording's.
        body: a SMPL-family file of your own; default: the bundled body.
        keep_frame: leave the motion where the laboratory has it, not on z = 0.
        processes: clips at a time with --all.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    from recon.cli import console

    if everything:
        if keep_frame or any(option is not None for option in (unit, up, mapping, fps)):
            raise ValueError("--all takes unit, axis and rate from each file; leave them out")
        _convert_folder(recording, out, body, processes, json, overwrite)
        return

    if mapping is None:
        from recon.formats.mocap.reader import refuse_unknown_skeleton

        refuse_unknown_skeleton(recording)
        if up is None:
            from recon.cli.looks import refuse_unknown_markers

            refuse_unknown_markers([recording], mapping, unit)
    from recon.jobs.convert import ConversionSettings, convert_file

    settings = ConversionSettings(unit, up, mapping, fps, body, keep_frame)
    report = convert_file(recording, out, settings, overwrite=overwrite)
    for decision in report["decisions"]:
        console.say(f"  {decision}")
    console.findings({kind: report[kind] for kind in ("repairs", "warnings")})
    console.table(str(out), {k: {"value": v} for k, v in report["conversion"].items()})
    console.last(str(out))
    if json:
        lists = ("decisions", "residuals_mm", "diagnosis", "repairs", "warnings")
        shown = {name: report[name] for name in lists}
        console.answer({**report["conversion"], **shown})


def _convert_folder(
    folder: Path, out: Path, body: Path | None, processes: int, json: bool, overwrite: bool
) -> None:
    from statistics import median

    from recon.batch.corpus import convert_corpus
    from recon.cli import console

    rows = convert_corpus(folder, out, processes=processes, body=body, overwrite=overwrite)
    kept = [row for row in rows if row.get("kept")]
    failed = [row for row in rows if row["status"] not in ("ok", "rejected")]
    summary = {
        "clips": len(rows),
        "converted": len(kept),
        "rejected": len(rows) - len(kept) - len(failed),
        "failed": len(failed),
        "minutes": round(sum(float(row["seconds"] or 0) for row in kept) / 60, 2),
        "median_residual_mm": median(float(row["residual_mm"] or 0) for row in kept)
        if kept
        else 0,
        "report": str(out / "report.csv"),
    }
    console.table(str(out), {key: {"value": value} for key, value in summary.items()})
    console.last(str(out))
    if json:
        console.answer(summary)
    if not kept:
        raise Failed(f"{folder}: no recording could be converted; see {out / 'report.csv'}")
    if bad := [row for row in rows if row["status"] not in ("ok", "rejected")]:
        raise Failed(
            f"{len(bad)} recordings could not be converted; {out / 'report.csv'} says why"
        )
