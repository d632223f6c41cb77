"""Observation files of one clip in, a motion file and a report out."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from recon.api.fit import fit
from recon.api.result import Result
from recon.fitting.settings import FitSettings
from recon.formats.outputs import Output, check_outputs, paths_in
from recon.reading.inputs import input_checksums


def fitted(
    paths: Sequence[Path], settings: FitSettings, shape: Sequence[float] | None = None
) -> Result:
    """What `recon.fit` makes of one clip's observation files.

    Args:
        paths: files and folders of one clip.
        settings: how to read and to fit them.
        shape: coefficients that are held instead of the settings' shape.

    Raises:
        FileNotFoundError, ValueError: for bad input.
    """
    how: dict[str, Any] = settings.arguments()
    if shape is not None:
        how["shape"] = shape
    return fit(list(paths), **how)


def fit_files(
    paths: Sequence[Path],
    out: Path,
    settings: FitSettings,
    *,
    shape: Sequence[float] | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Fit one clip's observation files by `recon.fit` and write OUT and OUT.json.

    A `shape` that is given is held, as clips of one subject share it. Returns the report; its
    `failed` says whether the fit met nan or inf, in which case the last finite estimate was
    written.

    Raises:
        FileNotFoundError, ValueError: for bad input; nothing is written then.
        FileExistsError: when OUT or OUT.json is there and recon did not write it, unless
            `overwrite`.
    """
    check_outputs([Output(out)], paths_in((*paths, settings)), overwrite=overwrite)
    # before anything is read: what changes from now on must not pass for what was fitted
    inputs = input_checksums({"observations": tuple(paths), **vars(settings)})
    result = fitted(paths, settings, shape)
    said = asdict(settings) | ({} if shape is None else {"shape": list(shape)})
    report = result.report(inputs, said)
    result.save(out, overwrite=overwrite, report=report)
    return report
