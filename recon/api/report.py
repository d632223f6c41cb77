"""What happened in a fit, stage by stage, as its report tells it."""

from collections.abc import Mapping
from typing import Any

from recon.fitting.long import LongReconstruction
from recon.formats.results.reports import versions
from recon.method.reconstruction import Reconstruction
from recon.method.stages import StageReport
from recon.solver.lbfgs import Termination


def describe(
    result: Reconstruction, inputs: Mapping[str, str], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """What happened, and to what: the beginning of OUT.json.

    Args:
        result: of the fit.
        inputs: SHA-256 of everything that was read, by path (`recon.fitting.clip_inputs`).
        settings: of the fit, by name.
    """
    windows = result.windows if isinstance(result, LongReconstruction) else ()
    failed = result.failed_windows if isinstance(result, LongReconstruction) else ()
    return {
        "failed": result.failed[0],
        "stages": [_stage(report) for report in result.reports],
        "windows": [
            {"start": start, "stop": stop, "failed": row in failed}
            for row, (start, stop) in enumerate(windows)
        ],
        "settings": dict(settings),
        "inputs": dict(inputs),
        "versions": versions(),
    }


def _stage(report: StageReport) -> dict[str, Any]:
    """One line; of several windows the most steps, the sums of energies, all reasons to end."""
    solution = report.solution
    energies = solution.trace[:, -1].sum(0).tolist()
    reasons = [reason for reason in Termination if reason in solution.termination]
    return {
        "name": report.stage.name,
        "seconds": round(report.seconds, 4),
        "iterations": int(solution.iterations.max()),
        "evaluations": int(solution.evaluations.max()),
        "termination": "; ".join(reason.value for reason in reasons),
        "energies": {
            term.name: value for term, value in zip(report.stage.terms, energies, strict=True)
        },
    }
