"""The cycle between those of two motion files: what `recon interpolate` does."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from recon.api.interpolate import interpolate
from recon.formats.reports import checksums, versions


@dataclass(frozen=True)
class InterpolationSettings:
    """How to mix two motions."""

    at: float
    """Share of the second, 0 to 1."""
    weights: str = "open"
    """Weights of the prior: `open`, `nc` or a file."""
    body: Path | None = None
    """A SMPL-family file; None is the bundled body."""
    fps: float | None = None
    """Frame rate of the result; None is the first file's rate."""


def interpolate_files(
    a: Path, b: Path, out: Path, settings: InterpolationSettings, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write what `recon.interpolate` makes of two motion files as OUT and OUT.json.

    Returns the report.

    Raises:
        FileNotFoundError, ValueError: as `recon.interpolate`; nothing is written then.
        FileExistsError: when something is there that recon did not write, unless `overwrite`.
    """
    made = interpolate(
        a, b, settings.at, weights=settings.weights, body=settings.body, fps=settings.fps
    )
    report = {
        **made.about,
        "settings": asdict(settings),
        "inputs": checksums((a, b)),
        "versions": versions(),
    }
    made.save(out, overwrite=overwrite, report=report)
    return report
