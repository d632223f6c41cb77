"""`recon.convert`: a recording of motion capture as a motion of the body."""

from pathlib import Path
from typing import Literal

from recon.api.given import BodyLike, body_given
from recon.api.results.motion import Made
from recon.core.arrays import positive
from recon.core.units import Axis
from recon.formats.mocap.recording import MarkerRecording, SkeletonRecording
from recon.ingest import single


def convert(
    recording: str | Path | SkeletonRecording | MarkerRecording,
    *,
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None,
    up: Axis | None = None,
    mapping: str | Path | None = None,
    fps: float | None = None,
    body: BodyLike = None,
    keep_frame: bool = False,
) -> Made:
    """Any recording of joints or markers of a body as a motion of the body.

    The result stands on z = 0 and keeps the recording's times. Nothing is random, and everything
    is computed on the processor.

    `about` of the result has `conversion` (flat numbers: frames, fps, residual_mm, slip_mps, ...),
    `decisions` (what was read, guessed or cut, a sentence each), `residuals_mm` (mean distance of
    every joint or marker, millimetres), and the lists `diagnosis`, `repairs` and `warnings`.

    Args:
        recording: a file (.bvh, .amc, .c3d, .trc, .mat, also .xz, or FILE::MEMBER of an archive),
            or what `recon.formats.mocap.reader.read_recording` made of it.
        unit: of the file; None finds it out.
        up: axis of the file that points up; None finds it out.
        mapping: JSON or TOML file that says which of its joints or markers are which.
        fps: rate of the result, frames per second; None is the recording's.
        body: whose motion it becomes; a SMPL-family file, or None for the bundled body.
        keep_frame: leave the motion where the laboratory has it, turned to z up at most, instead
            of standing it on z = 0; the plane that feet stand on is then in the file.

    Raises:
        ReconError: when it cannot be read, its unit or axis cannot be told, its skeleton or
            markers are not known or do not cover the body, or the rate is not positive.
        FileNotFoundError: when there is no such file.
    """
    model = body_given(body)
    rate = None if fps is None else positive(fps, "fps")
    source = str(recording) if isinstance(recording, Path) else recording
    found = single.convert(
        source, model, unit=unit, up=up, mapping=mapping, fps=rate,
        keep_frame=keep_frame,
    )  # fmt: skip
    about = {
        "conversion": dict(found.report),
        "decisions": list(found.decisions),
        "residuals_mm": {name: round(value, 2) for name, value in found.residuals.items()},
        **found.findings(),
    }
    lines = (f"mean residual {found.report['residual_mm']:.1f} mm", *found.decisions)
    return Made(
        found.file(model), model, found.warnings, about, lines, found.repairs, found.diagnosis
    )
