"""The size of every slip: the smallest that spoils fits without repairs, on validation people.

    python -m benchmarks.slips.sizes CORPUS
    python -m benchmarks.slips.sizes CORPUS --clips 6 --prior pose --only camera

A size spoils a clip when it doubles the error of the clean clip or adds 5 cm to it, and it is
taken when it spoils two clips in three. A wrong rate makes speeds wrong by its factor, twice at
least; noise blurs the factor that is measured, so that 1.5 times the clean clip's is taken for
spoiled. Slips of one size are measured all the same. The sizes are fixed before any threshold of
the diagnosis is chosen; the table reads them from the file written here.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.results import corpus_source, write
from benchmarks.slips.errors import error, spoiled_samples
from benchmarks.slips.kinds import SLIPS, Slip
from benchmarks.slips.recordings import SENSORS, Recording, evenly, recording_of, windows_of
from recon.body.model import BodyModel
from recon.core.struct import concatenate
from recon.fitting.clip import fit_clip
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions
from recon.method.protocols import Sensor as Seen

SIZES = Path(__file__).parents[1] / "results" / "slip_sizes.json"
ADDED = 0.05
"""Metres."""
MULTIPLIED = 2.0
SPEEDS = 1.5
_SHARE = 2 / 3
"""Share of the clips that a size must spoil."""


@dataclass(frozen=True)
class Tried:
    """One size on all clips."""

    size: float
    errors: tuple[float, ...]
    """Errors by clip, as the slip's measure has them."""
    spoiled: float
    """Share of the clips."""


@dataclass(frozen=True)
class Sized:
    """What was found for one slip."""

    slip: str
    size: float
    """The smallest that spoils enough clips, or the largest that was tried."""
    enough: bool
    """Whether it spoils enough of them."""
    unit: str
    measure: str
    clean: tuple[float, ...]
    """Errors of the clips without the slip."""
    tried: tuple[Tried, ...]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--clips", type=int, default=6)
    parser.add_argument("--prior", choices=("pose", "humor"), default="pose")
    parser.add_argument("--only", default="", help="slips whose key contains this")
    parser.add_argument("--json", type=Path, default=SIZES)
    arguments = parser.parse_args()
    body, settings = BodyModel.load(), FitOptions(prior=arguments.prior)
    windows = windows_of(arguments.corpus, "validation", body)
    clips = evenly(windows, arguments.clips)
    rows = _earlier(arguments.json) if arguments.only else {}
    for sensor in SENSORS:
        slips = [s for s in SLIPS if s.sensor == sensor and arguments.only in s.key]
        if len(slips) == 0:
            continue
        recordings = [recording_of(windows, k, sensor, body) for k in clips]
        clean = fitted([r.clean for r in recordings], settings, body)
        for slip in slips:
            began = time.process_time()
            found = sized(slip, recordings, clean, settings, body)
            rows[slip.key] = asdict(found)
            print(f"{slip.key:48s} {found.size:6g} {slip.unit:9s} {_shown(found)}  "
                  f"{time.process_time() - began:.0f} CPU s", flush=True)  # fmt: skip
            ordered = [rows[s.key] for s in SLIPS if s.key in rows]
            names = [windows.names[k] for k in clips]
            write(arguments.json, 0, corpus_source(arguments.corpus, windows.files),
                  windows=names, prior=arguments.prior, sizes=ordered)  # fmt: skip


def sized(
    slip: Slip,
    recordings: Sequence[Recording],
    clean: ClipFit,
    settings: FitOptions,
    body: BodyModel,
) -> Sized:
    """Climb the ladder of a slip until a size spoils enough clips."""
    before = _errors(clean, recordings, slip)
    tried: list[Tried] = []
    for size in slip.sizes:
        spoiled_clips = [slip.spoil(recording, size) for recording in recordings]
        errors = _errors(fitted(spoiled_clips, settings, body), recordings, slip)
        spoiled = [spoils(slip, a, b) for a, b in zip(before, errors, strict=True)]
        tried.append(Tried(size, errors, sum(spoiled) / len(spoiled)))
        if tried[-1].spoiled >= _SHARE:
            break
    last = tried[-1]
    return Sized(
        slip.key, last.size, last.spoiled >= _SHARE, slip.unit, slip.measure, before, tuple(tried)
    )


def spoils(slip: Slip, clean: float, slipped: float) -> bool:
    """Whether an error is that of a spoiled clip."""
    if slip.measure == "speed":
        return slipped >= SPEEDS * clean
    return slipped >= min(MULTIPLIED * clean, clean + ADDED)


def fitted(clips: Sequence[tuple[Seen, ...]], settings: FitOptions, body: BodyModel) -> ClipFit:
    """All clips in one batch, as they are."""
    return fit_clip([concatenate(list(part)) for part in zip(*clips, strict=True)], settings, body)


def chosen_sizes(path: Path = SIZES) -> dict[str, float]:
    """The size of every slip by its key.

    Raises:
        ValueError: when a slip has not been sized.
    """
    sizes = {row["slip"]: float(row["size"]) for row in _earlier(path).values()}
    if missing := [slip.key for slip in SLIPS if slip.key not in sizes]:
        raise ValueError(
            f"{path}: no size of {', '.join(missing)}; run python -m benchmarks.slips.sizes CORPUS"
        )
    return sizes


def _earlier(path: Path) -> dict[str, dict[str, Any]]:
    if not path.is_file():
        return {}
    return {row["slip"]: row for row in json.loads(path.read_text())["sizes"]}


def _errors(found: ClipFit, recordings: Sequence[Recording], slip: Slip) -> tuple[float, ...]:
    return tuple(
        error(found, recording, slip.measure, spoiled_samples(slip, recording.truth.frames), clip)
        for clip, recording in enumerate(recordings)
    )


def _shown(found: Sized) -> str:
    """Mean errors: clean, then of every size; centimetres, or factors."""
    factor = 1.0 if found.measure == "speed" else 100.0
    rows = [("clean", found.clean), *((f"{t.size:g}", t.errors) for t in found.tried)]
    shown = [f"{name}: {factor * sum(row) / len(row):.1f}" for name, row in rows]
    return ("" if found.enough else "NOT ENOUGH ") + ", ".join(shown)


if __name__ == "__main__":
    main()
