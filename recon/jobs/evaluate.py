"""A result file against a truth file: what `recon evaluate` does."""

from pathlib import Path

from recon.api.evaluate import evaluate
from recon.formats.reports import checksums, versions


def evaluate_files(
    result: Path,
    truth: Path,
    observation: Path | None,
    out: Path | None,
    body: Path | None = None,
    *,
    overwrite: bool = False,
) -> dict[str, float | None]:
    """All metrics of `recon.evaluate`, written to `out` if given, with checksums and versions.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when a file is damaged, the bodies differ, or the truth does not cover the
            result's times.
        FileExistsError: when `out` is there and recon did not write it, unless `overwrite`.
    """
    metrics = evaluate(result, truth, body, observation=observation)
    if out is not None:
        read = [path for path in (result, truth, observation) if path is not None]
        about = {"inputs": checksums(read), "versions": versions()}
        metrics.save(out, overwrite=overwrite, report=about)
    return metrics
