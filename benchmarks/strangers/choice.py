"""Chooses the windows of a fold's people that are fitted, spread over kinds of motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.strangers.folds import Fold
from recon.benchmark.dataset import clip_files, is_flat
from recon.benchmark.windows import FPS, TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.formats.motions import load_motion
from training.humor.corpus import described_action, kind_of_motion

FRAMES = 60
RUN_FRAMES = 30
"""Number of frames of windows of runs, which last less than two seconds."""


@dataclass(frozen=True)
class Chosen:
    """Windows of one fold, all of one length."""

    windows: TrueWindows
    flat: tuple[bool, ...]
    """Whether the ground of each is z = 0 everywhere; elsewhere contacts are not known."""


def chosen(
    fold: Fold, corpus: Path, body: BodyModel, frames: int, count: int, kind: str | None = None
) -> Chosen | None:
    """Choose about `count` windows of the held-out people, spread over kinds, clips and time.

    Args:
        fold: the held-out people.
        corpus: folder of all converted motions.
        body: body model of the motions.
        frames: length of every window, frames at 30 Hz.
        count: number of windows to take, if there are as many that share no frame.
        kind: the only kind of motion to take; None takes all.

    Returns:
        The windows; None where there are none.
    """
    files = clip_files(corpus)
    own = {
        clip: kind_of_motion(described_action(files[clip]))
        for clip, part in fold.splits.parts(list(files)).items()
        if part == "validation" and fold.splits.has_open_licence(clip)
    }
    slots: dict[str, list[list[tuple[str, int]]]] = {}
    for clip, its in own.items():
        if kind in (None, its):
            rounds = starts(load_motion(files[clip]).motion.resample(FPS).frames, frames)
            slots.setdefault(its, []).append([(clip, start) for start in rounds])
    rows = spread(list(slots.values()), count)
    if len(rows) == 0:
        return None
    listed = tuple((clip, start / FPS) for clip, start in rows)
    splits = replace(fold.splits, windows={"validation": {frames: listed}})
    windows = load_windows(corpus, splits, "validation", body, frames=frames)
    return Chosen(
        windows=windows,
        flat=tuple(is_flat(files[clip]) for clip in windows.clips),
    )


def starts(room: int, frames: int) -> list[int]:
    """Return first frames of as many disjoint windows as fit, from the middle outwards."""
    count = room // frames
    spare = room - count * frames
    places = [k * frames + int(spare * (k + 0.5) / count) for k in range(count)]
    return sorted(places, key=lambda place: (abs(2 * place + frames - room), place))


def spread(
    kinds: Sequence[Sequence[Sequence[tuple[str, int]]]], count: int
) -> list[tuple[str, int]]:
    """Choose equal numbers of windows of every kind as far as there are, and of every clip.

    Args:
        kinds: windows by kind and clip, those to be taken first in front.
        count: number of windows to take.
    """
    available = [sum(len(clip) for clip in clips) for clips in kinds]
    quota = [0] * len(kinds)
    while sum(quota) < min(count, sum(available)):
        for k, most in enumerate(available):
            if quota[k] < most and sum(quota) < count:
                quota[k] += 1
    rows = [row for clips, own in zip(kinds, quota, strict=True) for row in _of_kind(clips, own)]
    return sorted(rows)


def _of_kind(clips: Sequence[Sequence[tuple[str, int]]], count: int) -> list[tuple[str, int]]:
    """Choose one window of each clip, then a second one; evenly over clips that have one."""
    found: list[tuple[str, int]] = []
    for turn in range(max(len(clip) for clip in clips)):
        some = [clip[turn] for clip in clips if len(clip) > turn]
        wanted = min(count - len(found), len(some))
        places = np.linspace(0, len(some) - 1, wanted).round().astype(int) if wanted else []
        found += [some[place] for place in places]
    return found
