"""Values of single windows that `benchmarks.clouds` keeps between its runs; never committed."""

import json
from pathlib import Path
from typing import Any

from benchmarks.protocol import ROOT, Sources, about, commit
from benchmarks.protocol import corpus_source as corpus_source
from recon.formats.files.opening import replacing


def earlier(path: Path | None, table: str) -> dict[str, Any]:
    """A table that an earlier run of this commit left in a file; empty if none did."""
    if path is None or not path.is_file():
        return {}
    found = json.loads(path.read_text(encoding="utf-8"))
    return found[table] if found["about"]["commit"] == commit(ROOT) else {}


def write(path: Path, seed: int | None, sources: Sources, **tables: Any) -> None:
    """Write what the command that runs has found, in one step."""
    with replacing(path) as beside:
        beside.write_text(json.dumps({"about": about(seed, sources), **tables}, indent=1))
