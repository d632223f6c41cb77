"""Reads and writes the reports of results, whose checksums tell which files recon wrote.

A report is a JSON object. Besides the entries of a verb it holds

* `outputs`: SHA-256 of every file that was written with it, by name;
* `replaces`: SHA-256 of files of a former run that these replace, by name. A run that is killed
  between moving the report and moving its files leaves the former ones, still known as recon's;
* `report_checksum`: SHA-256 of all its other entries, by which a report that somebody edited is
  recognised.
"""

import json
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from recon.formats.replacing import file_checksum, value_checksum

_OUTPUTS, _REPLACES, _SEAL = "outputs", "replaces", "report_checksum"
_LARGEST = 1 << 28
"""Most bytes of a report; larger JSON files are not read, since recon did not write them."""


@dataclass(frozen=True)
class Report:
    """The checksums of a report that is unchanged since recon wrote it."""

    outputs: Mapping[str, str]
    """SHA-256 by name of file, relative to the report's folder."""
    replaces: Mapping[str, str]
    """Checksums of the files of a former run that were there before, by name."""
    content: Mapping[str, Any]
    """All entries of the report but its own checksum."""

    def checksum_if_own(self, name: str, path: Path) -> str | None:
        """Return a file's SHA-256 if the report lists it under the given name, else None."""
        known = {self.outputs.get(name), self.replaces.get(name)} - {None}
        if len(known) == 0 or not path.is_file():
            return None
        found = file_checksum(path)
        return found if found in known else None


def read_report(path: Path) -> Report | None:
    """Read the report of a JSON file; None if it is no report, or was changed."""
    if not path.is_file() or path.stat().st_size > _LARGEST:
        return None
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or found.pop(_SEAL, None) != value_checksum(found):
        return None
    outputs, replaces = found.get(_OUTPUTS), found.get(_REPLACES, {})
    if not (isinstance(outputs, dict) and isinstance(replaces, dict)):
        return None
    return Report(outputs, replaces, found)


def report_text(
    report: Mapping[str, Any], outputs: Mapping[str, str], replaces: Mapping[str, str]
) -> str:
    """Format a report as JSON with its checksum; values that JSON lacks become texts.

    Args:
        report: entries of the verb.
        outputs: SHA-256 of the files written with it, by name; empty where only the report is
            written.
        replaces: SHA-256 of the existing files that recon wrote and will now replace, by name.
    """
    whole = {**report, _OUTPUTS: dict(outputs)}
    if len(replaces) > 0:
        whole[_REPLACES] = dict(replaces)
    # through JSON and back, so that keys are texts and tuples are lists
    whole = json.loads(json.dumps(whole, default=str))
    return json.dumps({**whole, _SEAL: value_checksum(whole)}, indent=1) + "\n"


def versions() -> dict[str, str]:
    """Return the versions of recon, torch and Python that make a result, for its report."""
    return {
        "recon": version("motion-recon"),
        "torch": version("torch"),
        "python": platform.python_version(),
    }


def checksums(paths: Iterable[Path]) -> dict[str, str]:
    """Compute SHA-256 of input files, keyed by path, for a report's `inputs`."""
    return {str(path): file_checksum(path) for path in paths}
