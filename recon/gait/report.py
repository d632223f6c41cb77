"""`recon.report`: the laboratory report of a recording, a motion or a fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.api.convert import convert
from recon.api.given import BodyLike, MotionLike, body_given, motion_given
from recon.api.results import MotionResult, Tables
from recon.body.identities import body_weight
from recon.body.model import BodyModel
from recon.core.errors import FormatError
from recon.core.motion import MotionFile
from recon.core.units import Hand, Unit, Up
from recon.diagnosis.movement import belt_velocity
from recon.formats.outputs import check_outputs
from recon.formats.reports import checksums, read_report, versions
from recon.gait.analysis import Gait, analyse
from recon.gait.feet import MIN_SWING_M
from recon.gait.laboratory import LaboratoryReport, outputs_of
from recon.gait.plots import PointResiduals, matplotlib
from recon.mocap.asf_amc import recording_files


def report(
    source: MotionLike,
    *,
    unit: Unit | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
    mapping: str | Path | None = None,
    body: BodyLike = None,
) -> LaboratoryReport:
    """Analyse the gait of a recording or motion.

    Events, cycles, joint angles, spatio-temporal parameters, and how reliable they are.

    A recording is converted first, as `recon.convert` does. Of a motion file, the residuals and
    findings are those of the report beside it (FILE.json), of a result those that it has. On a
    treadmill all numbers are in the frame of the belt.

    Args:
        source: a recording (.c3d, .trc, .bvh, .amc, .mat), a motion file or its arrays, or what a
            function of `recon` returned.
        unit: of a recording; None finds it out.
        up: axis of a recording that points up, or down; None finds it out.
        hand: handedness of a recording's coordinates; None finds it out.
        mapping: JSON or TOML file that says which joints or markers of a recording are which.
        body: whose motion it is; only the bundled body has the landmarks that this needs.

    Raises:
        ReconError: when something is damaged, cannot be converted, or is of another body.
        FileNotFoundError: when there is no such file.
    """
    model = body_given(body)
    name = Path(str(source)).name if isinstance(source, Path | str) else "motion"
    if isinstance(source, Path | str) and Path(str(source)).suffix.lower() != ".npz":
        source = convert(source, unit=unit, up=up, hand=hand, mapping=mapping, body=model)
    elif (unit, up, hand, mapping) != (None, None, None, None):
        raise FormatError(
            f"{name}: unit, up, hand and mapping are options for recordings, not for motions"
        )
    stored = _report_of_source(source)
    try:
        file = motion_given(source, model).file
    except FormatError as error:
        raise FormatError(
            f"{error}; expected a recording or a motion: `recon fit` makes a motion of "
            "observations"
        ) from error
    return _laboratory_report(name, file, model, stored)


def _report_of_source(source: MotionLike) -> Mapping[str, Any]:
    """The stored report of a conversion or fit; empty if there is none."""
    if isinstance(source, MotionResult):
        return source.report()
    if not isinstance(source, Path | str):
        return {}
    beside = Path(f"{source}.json")
    if not beside.is_file():
        return {}
    if (found := read_report(beside)) is not None:
        return found.content
    message = f"{beside.name} is not as recon wrote it: residuals and findings in it are left out"
    return {"warnings": [{"code": "report", "message": message}]}


def _laboratory_report(
    name: str, file: MotionFile, body: BodyModel, stored: Mapping[str, Any]
) -> LaboratoryReport:
    motion = file.motion
    belt = belt_velocity(motion, body, file.observed)
    gait = analyse(
        motion,
        body,
        ground=None if file.ground is None else float(file.ground[3] / file.ground[2]),
        belt=belt,
        angle_std=file.angle_std,
        observed=file.observed,
    )
    tall, heavy = body.height(motion.shape), body_weight(body, motion.shape)
    decisions = (*stored.get("decisions", ()), *stored.get("read", ()))
    return LaboratoryReport(
        title=name,
        facts={
            "frames": str(motion.frames),
            "rate": f"{motion.fps:g} Hz",
            "length": f"{motion.frames / motion.fps:.2f} s",
            "stature of the fitted body": f"{float(tall):.2f} m",
            "its mass": f"{float(heavy):.0f} kg",
            **({} if belt is None else {"treadmill": f"{float(belt.norm()):.2f} m/s"}),
        },
        gait=gait,
        residuals=_residuals_of_report(stored),
        warnings=(*_finding_messages(stored, "warnings"), *_warnings_of_backward_strides(gait)),
        repairs=tuple(_finding_messages(stored, "repairs")),
        notes=tuple(_finding_messages(stored, "diagnosis")),
        decisions=tuple(str(one) for one in decisions),
    )


def _warnings_of_backward_strides(gait: Gait) -> list[str]:
    """Return a warning where strides lead against the direction in which the pelvis faces."""
    facing = np.deg2rad(gait.angles["pelvis_left_rotation"])
    # strides on the spot have no direction
    backward = sum(
        cycle.length * np.cos(np.interp(cycle.strike, gait.times, facing) - cycle.heading)
        < -MIN_SWING_M
        for cycle in gait.cycles
    )
    if backward == 0:
        return []
    return [
        f"{backward} of {len(gait.cycles)} strides go backwards: their events, shares of the "
        "cycle and pelvic rotations are wrong, since steps are found as in walking forwards"
    ]


def _finding_messages(stored: Mapping[str, Any], kind: str) -> Sequence[str]:
    """Messages of all findings of one kind, except residuals, which have plots."""
    return [
        str(one["message"])
        for one in stored.get(kind, ())
        if isinstance(one, Mapping) and "message" in one and one.get("code") != "residual"
    ]


def _residuals_of_report(stored: Mapping[str, Any]) -> tuple[PointResiduals, ...]:
    """Residuals by point, from the report of a conversion or of a fit's sensors."""
    found: list[PointResiduals] = []
    if isinstance(converted := stored.get("residuals_mm"), Mapping):
        values = {name: float(value) for name, value in converted.items()}
        found.append(
            PointResiduals("markers or joints of the recording", "mm", values, "mean distance")
        )
    for one in stored.get("residuals", ()):
        scale, unit = (1000.0, "mm") if one["unit"] == "metres" else (1.0, str(one["unit"]))
        values = {
            name: scale * value for name, value in one["by_point"].items() if value is not None
        }
        if len(values) > 0:
            found.append(PointResiduals(str(one["name"]), unit, values, "median distance"))
    return tuple(found)


@dataclass(frozen=True)
class WrittenReport:
    """A gait report that was written to files, and the lines to print about it."""

    place: Path
    """The page."""
    tables: Tables
    warnings: tuple[str, ...]


def report_file(
    trial: Path,
    out: Path | None = None,
    *,
    unit: Unit | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
    mapping: Path | None = None,
    overwrite: bool = False,
) -> WrittenReport:
    """Write a page with gait events, joint angles over the cycle, cadence, lengths and speed.

    Of a recording (.c3d, .trc, .bvh, .amc, .mat) or a motion file. The page needs no network; the
    table beside it (.csv) has all its numbers. It needs matplotlib: pip install
    'motion-recon[report]'.

    Args:
        trial: recording, or motion file of `recon fit` or `recon convert`, whose report is read,
            too.
        out: page to write; default: the trial's name with .html for its ending, in this folder.
        unit: of a recording; default: found out.
        up: axis of a recording that points up, or down; default: found out.
        hand: handedness of a recording's coordinates; default: found out.
        mapping: JSON or TOML file that says which markers of a recording are which.
        overwrite: replace files that are there and recon did not write.

    Raises:
        FileNotFoundError, ValueError: as `recon.report`; nothing is written then.
        FileExistsError: when a file is there and recon did not write it, unless `overwrite`.
    """
    # only the ending goes: walk.1.c3d and walk.2.c3d have pages of their own
    name = Path(trial.name.rpartition("::")[2].removesuffix(".xz")).stem
    page = Path(f"{name}.html") if out is None else out
    read = recording_files(trial) + ([] if mapping is None else [mapping])
    check_outputs(outputs_of(page), read, overwrite=overwrite)
    matplotlib()
    found = report(trial, unit=unit, up=up, hand=hand, mapping=mapping)
    said = {"inputs": checksums(read), "versions": versions()}
    found.save(page, overwrite=overwrite, report=said)
    figures = {
        f"{one.name} ({one.unit})": {"value": one.mean}
        for one in found.gait.figures
        if one.side == "both"
    }
    title = f"{trial}: {len(found.gait.cycles)} cycles of gait"
    return WrittenReport(page, {title: figures}, found.warnings)
