"""A motion file as another body would do it: what `recon retarget` does to files."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from recon.api.retarget import retarget
from recon.formats.reports import checksums, versions


@dataclass(frozen=True)
class RetargetSettings:
    """How to retarget."""

    shape: str
    """The body to move, as `recon.body.identities.identity` takes it."""
    method: str = "physics"
    """What is settled on the ground: the scaled copy, or the prior's proposal (`network`)."""
    weights: str = "open"
    """Weights of the network: `open`, `nc` or a file."""
    body: Path | None = None
    """A SMPL-family file; None is the bundled body."""
    fps: float | None = None
    """Frame rate of the result; None is the motion's rate."""
    ground: float | None = None
    """Height of the ground in the motion, metres; None is what the file says, else 0."""


def retarget_files(
    motion: Path, out: Path, settings: RetargetSettings, *, overwrite: bool = False
) -> dict[str, Any]:
    """Write what `recon.retarget` makes of a motion file as OUT and OUT.json.

    Returns the report: what `recon.retarget` says about the result, the files and the settings.

    Raises:
        FileNotFoundError, ValueError: as `recon.retarget`; nothing is written then.
        FileExistsError: when OUT or OUT.json is there and recon did not write it, unless
            `overwrite`.
    """
    made = retarget(
        motion,
        settings.shape,
        method=settings.method,
        weights=settings.weights,
        body=settings.body,
        fps=settings.fps,
        ground=settings.ground,
    )
    report = {
        **made.about,
        "source": {"file": str(motion), **made.about["source"]},
        "target": {"asked": settings.shape, **made.about["target"]},
        "settings": asdict(settings),
        "inputs": checksums([motion]),
        "versions": versions(),
    }
    made.save(out, overwrite=overwrite, report=report)
    return report
