"""`recon.convert`: a recording of motion capture as a motion of the body."""

from pathlib import Path

import numpy as np

from recon.api.given import BodyLike, MotionLike, body_given, motion_given
from recon.api.made import MadeMotion
from recon.api.result import motion_file_of
from recon.core.arrays import usable_frame_rate
from recon.core.units import Hand, Unit, Up
from recon.diagnosis.findings import Finding
from recon.ingest import single
from recon.ingest.transfer import transfer
from recon.mocap.recording import MarkerRecording, SkeletonRecording


def convert(
    recording: str | Path | SkeletonRecording | MarkerRecording,
    *,
    unit: Unit | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
    mapping: str | Path | None = None,
    fps: float | None = None,
    body: BodyLike = None,
    keep_frame: bool = False,
) -> MadeMotion:
    """Convert a motion capture recording (joints or markers) to a motion of the body model.

    Recordings of joints or markers (.bvh, .amc, .c3d, .trc, .mat, also .xz and FILE::MEMBER). The
    result stands on z = 0 and keeps the recording's times. Nothing is random, and everything is
    computed on the processor. `recon convert FOLDER FOLDER --all` converts a whole folder; see
    `recon convert-all --help`.

    Its report (`about`) has `conversion` (flat numbers: frames, fps, residual_mm, slip_mps, ...),
    `decisions` (what was read, guessed or cut, a sentence each), `residuals_mm` (mean distance of
    every joint or marker, millimetres), and the lists `diagnosis`, `repairs` and `warnings`.

    Args:
        recording: a file (.bvh, .amc, .c3d, .trc, .mat, also .xz, or FILE::MEMBER of an archive),
            or what `recon.mocap.reader.read_recording` made of it.
        unit: of the file; default: found out.
        up: axis of the file that points up, or down; default: found out.
        hand: handedness of the coordinates; default: found out.
        mapping: JSON or TOML file that says which of its joints or markers are which. Of markers
            without names (*1, U_1, unlabeled-12): a recording of the same person and set that has
            names, or the table of the set; default: they are looked for at usual places.
        fps: rate of the result, frames per second; default: the recording's.
        body: whose motion it becomes; a SMPL-family file; default: the bundled body.
        keep_frame: leave the motion where the laboratory has it, turned to z up at most, instead
            of standing it on z = 0; the plane that feet stand on is then in the file.

    Raises:
        ReconError: when it cannot be read, its unit or axis cannot be told, its skeleton or
            markers are not known or do not cover the body, or the rate is not positive.
        FileNotFoundError: when there is no such file.
    """
    model = body_given(body)
    rate = None if fps is None else usable_frame_rate(fps, "fps")
    source = str(recording) if isinstance(recording, Path) else recording
    found = single.convert(
        source, model, unit=unit, up=up, hand=hand, mapping=mapping, fps=rate,
        keep_frame=keep_frame,
    )  # fmt: skip
    about = {
        "conversion": dict(found.report),
        "decisions": list(found.decisions),
        "residuals_mm": {name: round(value, 2) for name, value in found.residuals.items()},
        **found.findings(),
    }
    lines = (f"mean residual {found.report['residual_mm']:.1f} mm", *found.decisions)
    shown = {"conversion": {key: {"value": value} for key, value in found.report.items()}}
    file = found.file(model)
    return MadeMotion(
        file, model, found.warnings, about, lines, found.repairs, found.diagnosis, shown
    )


_NEAR = 0.005
"""Metres of the median distance between the surfaces up to which the bodies agree."""


def to_body(motion: MotionLike, target: BodyLike, *, body: BodyLike = None) -> MadeMotion:
    """Transfer a motion to another body so that the two surfaces coincide.

    Shape and poses are fitted to the first body's surface, so the shape of the result means what
    it means on the target: betas of a SMPL file are SMPL's. The person and the motion stay the
    same; `recon.retarget` moves another person. Nothing is random.

    `about` of the result has the distance of the target's vertices from the first surface, over
    frames spread over the motion: `median_mm` and `percentile_95_mm`.

    Args:
        motion: one clip: a motion, a result, a motion file or its arrays.
        target: the body to bring it onto; a SMPL-family file, or None for the bundled body.
        body: whose motion it is; a SMPL-family file, or None for the bundled body.

    Raises:
        ReconError: when the motion is damaged or of another body.
        FileNotFoundError: when a file does not exist.
    """
    own, other = body_given(body), body_given(target)
    given = motion_given(motion, own)
    found = transfer(given.motion, own, other)
    median, most = (1000 * float(np.quantile(found.distances, share)) for share in (0.5, 0.95))
    warnings = () if median <= 1000 * _NEAR else (
        Finding(
            "body surface",
            f"the bodies {own.name!r} and {other.name!r} do not agree: half of the surface of one "
            f"is more than {median:.0f} mm from the other",
            value=median / 1000,
        ),
    )  # fmt: skip
    ground = given.file.ground
    level = None if ground is None else float(ground[3] / ground[2])
    file = motion_file_of(found.motion, other, level, observed=given.file.observed)
    about = {
        "source": own.name,
        "target": other.name,
        "median_mm": round(median, 2),
        "percentile_95_mm": round(most, 2),
    }
    line = f"surface of {other.name!r}: median {median:.1f} mm from that of {own.name!r}"
    return MadeMotion(file, other, warnings, about, (line,))
