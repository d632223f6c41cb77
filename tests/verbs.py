"""Verbs of the command line with files and values of Python: the same path, without words."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from recon.api.simulate import simulate
from recon.cli import listing
from recon.cli.places import Place
from recon.fitting.settings import DEFAULTS, FitSettings
from recon.simulation.points import Corruption
from recon.simulation.settings import (
    FILM_DEFAULTS,
    SURFACE_DEFAULTS,
    FilmSettings,
    SensorKind,
    SurfaceSettings,
)


def report_of(name: str, out: Path, **given: Any) -> dict[str, Any]:
    """What the report beside OUT says after a verb wrote it.

    Args:
        name: of the verb.
        out: file or folder to write.
        given: other arguments of the verb, by name.
    """
    listing.function_of_verb(name)(out=out, quiet=True, **given)
    report = out.with_name(f"{out.name}.json") if out.is_file() else out / "report.json"
    return json.loads(report.read_text(encoding="utf-8"))


def declared_outputs(verb: Callable[..., Any]) -> tuple[Place, ...]:
    """Return the outputs that `writes` declared for a verb; () for one that only reads."""
    return vars(verb).get("writes", ())


def fit_files(
    paths: Sequence[Path], out: Path, settings: FitSettings = DEFAULTS, **given: Any
) -> dict[str, Any]:
    """What `recon fit PATHS --out OUT` reports."""
    return report_of("fit", out, observations=tuple(paths), settings=settings, **given)


def simulate_file(
    motion: Path,
    out: Path,
    kind: SensorKind,
    corruption: Corruption,
    film: FilmSettings = FILM_DEFAULTS,
    surface: SurfaceSettings = SURFACE_DEFAULTS,
    **others: Any,
) -> tuple[Path, ...]:
    """Paths of what a sensor would have seen of a motion file, once it is written."""
    how = {**vars(corruption), **vars(film), **vars(surface), **others}
    return simulate(motion, kind, **how).save(out)
