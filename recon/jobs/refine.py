"""A file of an estimated motion, refined: what `recon refine` does to files."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from recon.api.refine import refine
from recon.fitting.settings import RefineSettings
from recon.formats.outputs import Output, check_outputs, paths_in
from recon.formats.reports import checksums
from recon.method.stages import Watch


def refine_files(
    motion: Path,
    out: Path,
    settings: RefineSettings,
    watch: Watch | None = None,
    *,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write what `recon.refine` makes of a file as OUT and OUT.json; returns the report.

    Raises:
        FileNotFoundError, ValueError: as `recon.refine`; nothing is written then.
        FileExistsError: when OUT or OUT.json is there and recon did not write it, unless
            `overwrite`.
    """
    check_outputs([Output(out)], paths_in((motion, settings)), overwrite=overwrite)
    inputs = checksums([motion])
    result = refine(
        motion,
        settings.prior,
        weights=settings.weights,
        body=settings.body,
        shape=settings.shape,
        frame_rate=settings.frame_rate,
        fps=settings.fps,
        up=settings.up,
        person=settings.person,
        ground=settings.ground,
        physics=settings.physics,
        callback=watch,
    )
    report = result.report(inputs, asdict(settings))
    result.save(out, overwrite=overwrite, report=report)
    return report
