"""Cycles of gait in the converted corpus: what was found where, and which the tables test on.

python -m benchmarks.cycles CORPUS --json benchmarks/results/cycles.json --picture docs/cycles.png
"""

import argparse
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results import corpus_source, show, write
from recon.benchmark.dataset import SPLITS, Part, Splits, clip_files, is_flat
from recon.body.cycles import RATE, Cycle, find_cycles, hip_flexion
from recon.core.motion import Motion
from recon.formats.motions import load_motion

FPS = 50.0
_ACTIONS = (
    "run", "dash", "walk-back", "walk-left", "walk-right", "walk-turn-left", "walk-turn-right",
    "walk", "dance", "kick", "punch", "slash", "guide", "bye", "wave", "raise", "call", "respond",
    "salsa", "martial",
)  # fmt: skip
"""Words that name actions, the longer first; CMU clips are named by number."""


@dataclass(frozen=True)
class FoundCycle:
    """One cycle and where it is from."""

    clip: str
    subject: str
    cycle: Cycle
    motion: Motion
    """The motion of the cycle alone, at 50 Hz."""


def found_cycles(
    corpus: Path, splits: Splits, part: Part | None, clips: Collection[str] | None = None
) -> Iterator[FoundCycle]:
    """All cycles of one part, or of the whole corpus, on flat ground, clip by clip.

    `clips` are the only ones that are looked at; None is all.
    """
    files = clip_files(corpus)
    for name, own in splits.parts(list(files)).items():
        if clips is not None and name not in clips:
            continue
        if (part is not None and own != part) or not is_flat(files[name]):
            continue
        motion = load_motion(files[name]).motion
        for cycle in find_cycles(motion):
            frames = max(round(cycle.duration * FPS), 2) + 1
            yield FoundCycle(name, splits.subject(name), cycle, cycle.of(motion, frames))


def chosen(found: list[FoundCycle], each: int) -> list[FoundCycle]:
    """Cycles, so many of every subject, of clips evenly spread over its names, one of each.

    From every clip it is the middle cycle, so that nobody chose it by looking.
    """
    by_clip: dict[str, list[FoundCycle]] = defaultdict(list)
    for one in found:
        by_clip[one.clip].append(one)
    by_subject: dict[str, list[FoundCycle]] = defaultdict(list)
    for clip in sorted(by_clip):
        cycles = by_clip[clip]
        by_subject[cycles[0].subject].append(cycles[len(cycles) // 2])
    picked: list[FoundCycle] = []
    for subject in sorted(by_subject):
        own = by_subject[subject]
        rows = np.unique(np.linspace(0, len(own) - 1, min(each, len(own))).round().astype(int))
        picked += [own[row] for row in rows]
    return picked


def action(clip: str) -> str:
    """What the name of a clip says is done in it."""
    return next((word for word in _ACTIONS if word in clip), "CMU, not named")


def _report(corpus: Path, splits: Splits) -> tuple[dict[str, dict[str, Any]], list[FoundCycle]]:
    parts = splits.parts(list(clip_files(corpus)))
    found = list(found_cycles(corpus, splits, None))
    groups: dict[str, list[FoundCycle]] = defaultdict(list)
    for one in found:
        licence = "open" if splits.is_open(one.clip) else "nc only"
        groups[f"{parts[one.clip]}, {licence}"].append(one)
    table = {
        name: {
            "cycles": len(own),
            "clips": len({one.clip for one in own}),
            "subjects": len({one.subject for one in own}),
            "minutes": sum(one.cycle.duration for one in own) / 60,
            "mean_duration": float(np.mean([one.cycle.duration for one in own])),
            "durations": np.percentile([one.cycle.duration for one in own], (0, 5, 50, 95, 100)),
            "left": sum(one.cycle.side == "left" for one in own),
            "mean_cost": float(np.mean([one.cycle.cost for one in own])),
            "actions": dict(Counter(action(one.clip) for one in own).most_common()),
        }
        for name, own in sorted(groups.items())
    }
    plain = {
        name: {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in row.items()}
        for name, row in table.items()
    }
    return plain, found


def _draw(found: list[FoundCycle], path: Path) -> None:
    """Hips of some cycles over their phase; durations; costs."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4), layout="constrained")
    FigureCanvasAgg(figure)
    hips, durations, costs = figure.subplots(1, 3)
    left = [one for one in found if one.cycle.side == "left"]
    for one in left[:: max(1, len(left) // 60)]:
        flexion = np.degrees(hip_flexion(one.motion))
        phase = np.linspace(0, 1, len(flexion))
        hips.plot(phase, flexion[:, 0], "C0", alpha=0.25, lw=0.8)
        hips.plot(phase, flexion[:, 1], "C1", alpha=0.25, lw=0.8)
    hips.set(xlabel="phase", ylabel="flexion, degrees", title="left (blue) and right hip")
    durations.hist([one.cycle.duration for one in found], 60)
    durations.set(xlabel="duration, s", title=f"{len(found)} cycles")
    costs.hist([one.cycle.cost for one in found], 60, log=True)
    costs.set(xlabel="cost", title=f"compared at {RATE} Hz")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


def _main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path, help="folder of all converted motions")
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--picture", type=Path, default=None)
    given = parser.parse_args()
    table, found = _report(given.corpus, Splits.load(given.splits))
    for name, row in table.items():
        show(name, {k: v for k, v in row.items() if isinstance(v, int | float)})
    if given.picture is not None:
        _draw(found, given.picture)
    if given.json is not None:
        write(given.json, None, corpus_source(given.corpus), cycles=table)


if __name__ == "__main__":
    _main()
