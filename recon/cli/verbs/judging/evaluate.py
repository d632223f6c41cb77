"""`recon evaluate`: a result against the truth."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from recon.cli.places import Overwrite, Place, its_own_report, writes


@writes(Place("json", its_own_report))
def evaluate(
    result: Positional[Path],
    truth: Positional[Path],
    obs: Path | None = None,
    body: Path | None = None,
    json: Annotated[Path | None, arg(help="File for the metrics.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Every metric of a reconstruction, in SI units.

    The truth is interpolated at the result's times.

    Args:
        result: motion file.
        truth: motion file that lasts at least as long.
        obs: the observation that was fitted, for errors of its own points.
        body: the SMPL-family file of both motions' body; default: the bundled body.
        json: file to write the metrics to.
        overwrite: replace files that are there and recon did not write.
    """
    from recon.cli import console
    from recon.jobs.evaluate import evaluate_files

    metrics = evaluate_files(result, truth, obs, json, body, overwrite=overwrite)
    console.table(f"{result} against {truth}", {k: {"value": v} for k, v in metrics.items()})
    if json is None:
        console.answer(metrics)
