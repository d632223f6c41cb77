"""A recording or a motion file as a laboratory report: what `recon report` does."""

from pathlib import Path
from typing import Literal

from recon.api.results.laboratory import LaboratoryReport
from recon.api.verbs.report import report
from recon.core.units import Axis
from recon.formats.results.outputs import check_outputs
from recon.formats.results.reports import checksums, versions
from recon.jobs.convert import recording_files
from recon.view.laboratory.files import outputs_of
from recon.view.laboratory.plots import require_matplotlib


def report_file(
    source: Path,
    out: Path | None = None,
    *,
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | None = None,
    up: Axis | None = None,
    mapping: Path | None = None,
    overwrite: bool = False,
) -> tuple[Path, LaboratoryReport]:
    """Write the page OUT and the table beside it; the default is the source's name, here.

    Returns where the page is, and what it says.

    Raises:
        FileNotFoundError, ValueError: as `recon.report`; nothing is written then.
        FileExistsError: when a file is there and recon did not write it, unless `overwrite`.
    """
    page = Path(f"{source.name.partition('.')[0]}.html") if out is None else out
    read = recording_files(source) + ([] if mapping is None else [mapping])
    check_outputs(outputs_of(page), read, overwrite=overwrite)
    require_matplotlib()
    found = report(source, unit=unit, up=up, mapping=mapping)
    said = {"inputs": checksums(read), "versions": versions()}
    found.save(page, overwrite=overwrite, report=said)
    return page, found
