"""`recon fit`: observation files in, a motion out."""

from pathlib import Path
from typing import Annotated, Any

from tyro.conf import OmitArgPrefixes, Positional, arg

from recon.cli.errors import Failed
from recon.cli.places import Arguments, Overwrite, Place, Quiet, a_file, folder, writes
from recon.fitting.settings import DEFAULTS, FitSettings
from recon.formats.outputs import Output


def _outputs(path: Path, given: Arguments) -> tuple[Output, ...]:
    """A folder where everybody is fitted, else a file with its report."""
    everybody = given["settings"].person == "all"
    return folder(path, given) if everybody else a_file(path, given)


@writes(Place("out", _outputs))
def fit(
    observations: Positional[tuple[Path, ...]],
    out: Path,
    settings: OmitArgPrefixes[FitSettings] = DEFAULTS,
    json: Annotated[bool, arg(help="Print the report as JSON on stdout.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Reconstruct the motion behind what was recorded of one clip.

    Several observations add up. Of each kind there may be any number, in any order:
    observation files (.npz) of 3D joints, markers, keypoints or points; 3D keypoints of
    FreeMoCap (session folder), MediaPipe, MotionBERT, Azure Kinect, Anipose, Pose2Sim or
    your own (.npy, .npz, .csv, .json, .trc); markers of a laboratory (.c3d, .trc); with
    --frame-rate and --camera (which one view of a phone does not need), 2D detections of
    OpenPose, MMPose, AlphaPose, MediaPipe, DeepLabCut, EasyMocap or Pose2Sim (a folder or
    file per view, or a folder of views); a folder of scans (.ply, .pcd); a folder of 16-bit
    depth images (.png, with --camera).

    Writes OUT (AMASS .npz with joints, contacts and ground) and OUT.json (what happened). With
    --person all, OUT is a folder with a file for everybody in the detections, all in one world,
    and report.json.

    Args:
        observations: files and folders of one clip.
        out: motion file to write; a folder with --person all.
        settings: how to fit.
        json: print the report as JSON on stdout.
        overwrite: replace files that are there and recon did not write.
        quiet: say nothing but errors and, last, where the result is.
    """
    del quiet  # heeded by `writes`
    fit_and_say(observations, out, settings, json=json, overwrite=overwrite)


def fit_and_say(
    observations: tuple[Path, ...],
    out: Path,
    settings: FitSettings,
    *,
    json: bool,
    overwrite: bool,
) -> None:
    """Fit, and tell what a person at the terminal should know.

    Raises:
        Failed: when the fit met nan or inf.
        FileNotFoundError, ValueError: for bad input.
    """
    from recon.cli import console
    from recon.cli.own import check_plugs
    from recon.formats.foreign import refuse_foreign
    from recon.method.plugins import SENSORS, registered

    check_plugs(settings.prior, settings.reader)
    if settings.reader is None and not registered(SENSORS):
        refuse_foreign(observations)
        if settings.up is None:
            from recon.cli.looks import refuse_unknown_markers

            refuse_unknown_markers(observations, settings.mapping, settings.unit)
    from recon.jobs.fit import fit_files, fit_people_files

    if settings.person == "all":
        with console.fitting({}) as watch:
            report = fit_people_files(observations, out, settings, watch, overwrite=overwrite)
        tell_people(report, out, json=json)
        return
    with console.fitting({}) as watch:
        report = fit_files(observations, out, settings, watch, overwrite=overwrite)
    tell(report, out, json=json)


def tell(report: dict[str, Any], out: Path, *, json: bool) -> None:
    """Tell what a person at the terminal should know about a fit that was written.

    Raises:
        Failed: when the fit met nan or inf.
    """
    from recon.cli import console

    for line in report["read"]:
        console.note(line)
    for stage in report["stages"]:
        console.say(
            f"{stage['name']:<9} {stage['iterations']:>4} iterations {stage['seconds']:>7.2f} s, "
            f"total {sum(stage['energies'].values()):.4g}: {stage['termination']}"
        )
    if cycle := report.get("cycle"):
        residuals = ", ".join(f"{mm:.0f}" for mm in cycle["residual_mm"] if mm is not None)
        console.say(
            f"one cycle of {cycle['seconds']:.2f} s, seen at {cycle['moments_seen']} moments, "
            f"code distance {cycle['code_distance']:.2f}, "
            f"residual {residuals} mm"
        )
    for one in report.get("stretches", ()):
        console.say(
            f"{one['start']:7.2f} s to {one['stop']:7.2f} s: {one['prior']}, seen at "
            f"{one['moments_seen']} moments"
            + (f", {one['joined']} of {one['cycles']} cycles of gait" if one["cycles"] else "")
        )
    console.findings(report)
    console.last(str(out))
    if json:
        console.answer(report)
    if report["failed"]:
        reasons = "; ".join(s["termination"] for s in report["stages"])
        raise Failed(f"{out}: {reasons}")


def tell_people(report: dict[str, Any], out: Path, *, json: bool) -> None:
    """Tell what a person at the terminal should know about fits of several people.

    Raises:
        Failed: when a fit met nan or inf.
    """
    from recon.cli import console

    for line in report["read"]:
        console.note(line)
    console.findings(report)
    console.table("people", report["summary"])
    console.last(str(out))
    if json:
        console.answer(report)
    if report["failed"]:
        raise Failed(f"{out}: a fit met nan or inf")
