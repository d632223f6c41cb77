"""Measured rows on disk, so that an interrupted or a longer run does not measure them again."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.results import dumps
from recon.formats.opening import replacing


@dataclass(frozen=True)
class Kept:
    """A folder with one file for every unit of work."""

    folder: Path
    identity: Mapping[str, Any]
    """What the rows were measured with; rows of another identity are measured again."""
    commit: str | None
    """The commit that runs, with `+` where files differ; nothing is read again then, nor without
    git."""

    def rows(self, name: str, measure: Callable[[], list[dict[str, Any]]]) -> list[dict[str, Any]]:
        """The rows of a unit, as an earlier run of this commit left them, or measured now."""
        path = self.folder / f"{name.replace(' ', '_').replace('/', '_')}.json"
        identity = json.loads(json.dumps({**self.identity, "commit": self.commit}))
        clean = self.commit is not None and not self.commit.endswith("+")
        if clean and path.is_file():
            earlier = json.loads(path.read_text(encoding="utf-8"))
            if earlier["identity"] == identity:
                return earlier["rows"]
        # as JSON gives it back, so that what is shown now is what is shown later
        found = json.loads(json.dumps(measure()))
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as beside:
            beside.write_text(dumps({"identity": identity, "rows": found}), encoding="utf-8")
        return found
