"""Metrics of a result by name, as `recon.evaluate` returns them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from recon.api.results.printing import one_line
from recon.formats.results.reports import versions
from recon.formats.results.writing import write_report

_SHOWN = {
    "joints_all": ("joints, all", 100, "cm"),
    "joints_visible": ("joints that were seen", 100, "cm"),
    "joints_hidden": ("joints that were hidden", 100, "cm"),
    "pa_joints": ("joints after a similarity", 100, "cm"),
    "vertices": ("skin", 100, "cm"),
    "accel_error": ("acceleration", 1, "m/s²"),
    "slip_speed": ("slip of feet in contact", 1, "m/s"),
    "sole_penetration_dist": ("depth of soles below the ground", 100, "cm"),
}
"""Metrics that are printed: words, factor and unit."""


class Evaluation(dict[str, float | None]):
    """Metrics by name, in SI units; None where a value cannot be computed.

    It is a dictionary; printed, it says the most important ones in at most ten lines.
    """

    def save(
        self,
        path: Path | str,
        *,
        overwrite: bool = False,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the metrics as JSON.

        Args:
            path: file to write.
            overwrite: replace a file that is there and recon did not write.
            report: what to write beside the metrics instead of the versions of the programs.

        Raises:
            FileExistsError: when it is there and recon did not write it, unless `overwrite`.
        """
        about = {"versions": versions()} if report is None else report
        write_report(Path(path), {**self, **about}, overwrite=overwrite)

    def __repr__(self) -> str:
        """The most important metrics in at most ten lines."""
        values = ((self.get(key), *words) for key, words in _SHOWN.items())
        lines = [f"{w}: {factor * v:.2f} {unit}" for v, w, factor, unit in values if v is not None]
        told = sum(value is not None for value in self.values())
        first = f"Evaluation: {told} of {len(self)} metrics could be told, among them errors of"
        return "\n".join([first, *map(one_line, lines)])
