"""A recording of motion capture as a motion file: what `recon convert` does to one."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from recon.api.convert import convert
from recon.core.units import Axis
from recon.formats.mocap.asf_amc import find_skeleton
from recon.formats.reports import checksums, versions


@dataclass(frozen=True)
class ConversionSettings:
    """How to convert; what is None is found out."""

    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None
    """Unit of the recording."""
    up: Axis | None = None
    """Axis of the recording that points up."""
    mapping: Path | None = None
    """JSON or TOML file that says which joints or markers are which."""
    fps: float | None = None
    """Rate of the result; None is the recording's."""
    body: Path | None = None
    """A SMPL-family file; None is the bundled body."""
    keep_frame: bool = False
    """Leave the motion where the recording has it instead of standing it on z = 0."""


def convert_file(
    recording: Path, out: Path, settings: ConversionSettings, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write a recording (FILE, or FILE::MEMBER of an archive) as the motion OUT, and OUT.json.

    Returns the report: what was decided, residuals (mm) by joint or marker, and flat numbers
    under `conversion`.

    Raises:
        FileNotFoundError, ValueError: as `recon.convert`; nothing is written then.
        FileExistsError: when OUT or OUT.json is there and recon did not write it, unless
            `overwrite`.
    """
    read = recording_files(recording)
    found = convert(
        recording, unit=settings.unit, up=settings.up, mapping=settings.mapping, fps=settings.fps,
        body=settings.body, keep_frame=settings.keep_frame,
    )  # fmt: skip
    read += [path for path in (settings.mapping, settings.body) if path is not None]
    report = {
        **found.about,
        "settings": asdict(settings),
        "inputs": checksums(read),
        "versions": versions(),
    }
    found.save(out, overwrite=overwrite, report=report)
    return report


def recording_files(recording: Path) -> list[Path]:
    """The files that a recording is read from.

    Raises:
        FileNotFoundError: when the skeleton of an .amc file is missing.
    """
    path = Path(str(recording).partition("::")[0])
    if path.name.lower().endswith((".amc", ".amc.xz")) and path.is_file():
        return [path, find_skeleton(path)]
    return [path]
