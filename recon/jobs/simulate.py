"""A motion file as sensors would have seen it, as observation files: what `simulate` does."""

from dataclasses import asdict
from pathlib import Path

from recon.api.simulate import simulate
from recon.formats.outputs import paths_in
from recon.formats.reports import checksums, versions
from recon.simulation.points import Corruption
from recon.simulation.settings import (
    FILM_DEFAULTS,
    SURFACE_DEFAULTS,
    FilmSettings,
    SensorKind,
    SurfaceSettings,
)


def simulate_file(
    motion: Path,
    out: Path,
    kind: SensorKind,
    corruption: Corruption,
    *,
    seed: int,
    fps: float | None = None,
    frames: tuple[int, int] | None = None,
    unknown_ground: bool = False,
    film: FilmSettings = FILM_DEFAULTS,
    surface: SurfaceSettings = SURFACE_DEFAULTS,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write what a sensor would have seen of a motion file; returns what was written.

    One camera writes OUT, several write OUT/CAMERA.npz; scans whose OUT does not end in .npz are a
    folder of PLY files with times.csv. A report is beside every file, and in every folder.

    Raises:
        FileNotFoundError, ValueError: as `recon.simulate`; nothing is written then.
        FileExistsError: when a file to write is there and recon did not write it, unless
            `overwrite`.
    """
    made = simulate(
        motion, kind, seed=seed, fps=fps, frames=frames, unknown_ground=unknown_ground,
        **vars(corruption), **vars(film), **vars(surface),
    )  # fmt: skip
    report = {
        "kind": kind,
        "settings": {
            **asdict(corruption), **asdict(film), **asdict(surface), "seed": seed, "fps": fps,
            "frames": frames, "unknown_ground": unknown_ground,
        },
        "inputs": checksums([motion, *paths_in(film)]),
        "versions": versions(),
    }  # fmt: skip
    return made.save(out, overwrite=overwrite, report=report)
