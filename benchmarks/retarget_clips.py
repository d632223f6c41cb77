"""Which clips are retargeted to which bodies: the committed table, how it was drawn, its motions.

    python -m benchmarks.retarget_clips CORPUS

writes `benchmarks/identities.toml` anew: test and validation clips on flat ground, at most 12 of
a subject and evenly over their names; of each the middle 10 s at 20 Hz, 2 s at least. Left out
is what is more than 25 cm above the ground in more than 5 frames (HUMOS). Every other clip goes
to the proportions of a person of the training part (CMU only; nobody who is held out or whose
clip it is), the others to shapes drawn from the body's shape space, N(0, I) with no coefficient
beyond 2. Seeded: the same corpus gives the same table.
"""

import argparse
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.benchmark.dataset import SPLITS, Licence, Part, Splits, clip_files, is_flat
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.formats.motions import load_motion
from recon.formats.opening import replacing
from recon.physics.metrics import NO_GROUND

IDENTITIES = Path(__file__).parent / "identities.toml"
FPS = 20.0
LONGEST, SHORTEST = 200, 40
"""Frames."""
EACH = 12
"""Clips of a subject at most."""
SEED = 2024
HIGH, HIGH_FRAMES = 0.25, 5
"""Clips whose lowest point is higher (metres) in more frames are left out."""
GROUND = 0.25
"""Share of frames whose lowest point is below the ground. Standing bodies are then on it, and so
are running ones; of 0, 5, 25 and 50 % the one of the least PhysDiff error and the most stable
truth on validation clips but for 50 %, which sinks the stance of runs."""
_BEYOND = 2.0
_SKIPPED = {"49_21"}  # hangs on ropes
_HELD_OUT = ("test", "validation")


@dataclass(frozen=True)
class Job:
    """One motion and the body that is to perform it."""

    name: str
    subject: str
    motion: Motion
    """The motion on its own body, on the ground, 20 Hz."""
    target: Float[Tensor, " shape"]
    real: bool
    """The target has the proportions of a recorded person."""
    flies: bool
    """The source leaves the ground by more than 5 cm in some frame, as runs and jumps do."""


def load_jobs(
    corpus: str | Path,
    splits: Splits,
    part: Part,
    licence: Licence,
    body: BodyModel,
    table: Path = IDENTITIES,
) -> list[Job]:
    """All clips that the table lists for a part.

    Raises:
        FileNotFoundError: when the corpus lacks a listed clip.
    """
    listed = tomllib.loads(table.read_text(encoding="utf-8"))
    files = clip_files(corpus)
    jobs: list[Job] = []
    for clip, start, frames, target in listed[part]:
        if licence == "open" and not splits.is_open(clip):
            continue
        if clip not in files:
            raise FileNotFoundError(f"{corpus}: no clip {clip}, which {table.name} lists")
        motion = load_motion(files[clip]).motion.resample(FPS).window(start, start + frames)
        motion = grounded(motion.replace(start_time=0.0), body)
        shape = listed["people"][target] if isinstance(target, str) else target
        jobs.append(
            Job(
                name=clip,
                subject=splits.subject(clip),
                motion=motion,
                target=torch.tensor(shape, dtype=motion.shape.dtype),
                real=isinstance(target, str),
                flies=bool((lowest(motion, body) > NO_GROUND).any()),
            )
        )
    if len(jobs) == 0:
        raise ValueError(f"{table.name} lists no {licence} clips of the {part} part")
    return jobs


def lowest(motion: Motion, body: BodyModel) -> Float[Tensor, " time"]:
    """Height of the lowest vertex in every frame, metres."""
    return body.pose(motion).vertices[..., 2].amin(-1)


def grounded(motion: Motion, body: BodyModel, share: float = GROUND) -> Motion:
    """Lifted or lowered as a whole, until this share of frames reaches below the ground."""
    level = lowest(motion, body).quantile(share)
    return motion.replace(translation=motion.translation - level * motion.translation.new_tensor(
        [0.0, 0.0, 1.0]))  # fmt: skip


def middle(motion: Motion) -> tuple[int, int] | None:
    """First frame and number of frames of the window; None where the clip is too short."""
    frames = min(motion.frames, LONGEST)
    return ((motion.frames - frames) // 2, frames) if frames >= SHORTEST else None


def is_high(motion: Motion, body: BodyModel) -> bool:
    """The body leaves the ground for longer than a jump: it stands on or hangs from something."""
    return int((lowest(motion, body) > HIGH).sum()) > HIGH_FRAMES


def evenly(names: list[str], most: int) -> list[str]:
    """Some of the names, so many, evenly spread."""
    if len(names) <= most:
        return names
    return [names[round(k)] for k in np.linspace(0, len(names) - 1, most)]


def draw_targets(
    own: Sequence[Sequence[float]], people: Mapping[str, Sequence[float]], seed: int
) -> list[str | list[float]]:
    """Targets for clips of these shapes: in even places people, in odd ones drawn shapes."""
    random = np.random.default_rng(seed)
    drawn: list[str | list[float]] = []
    for place, shape in enumerate(own):
        others = [name for name, known in people.items() if not np.allclose(known, shape)]
        person = str(random.choice(others))
        normal = random.standard_normal(len(shape))
        while (outside := np.abs(normal) > _BEYOND).any():
            normal[outside] = random.standard_normal(int(outside.sum()))
        drawn.append(person if place % 2 == 0 else [round(float(x), 3) for x in normal])
    return drawn


def _usable(
    files: Mapping[str, Path], clips: Sequence[str], body: BodyModel
) -> Iterator[tuple[str, int, int, list[float]]]:
    for clip in clips:
        if clip in _SKIPPED or not is_flat(files[clip]):
            continue
        motion = load_motion(files[clip]).motion.resample(FPS)
        window = middle(motion)
        if window is None:
            continue
        start, frames = window
        if not is_high(motion.window(start, start + frames), body):
            yield clip, start, frames, _rounded(motion.shape)


def _people(
    files: Mapping[str, Path], parts: Mapping[str, Part], splits: Splits
) -> dict[str, list[float]]:
    """Shapes of the training part by subject, without those that a held-out clip has."""
    held, found = set(), {}
    for clip, part in parts.items():
        shape = tuple(_rounded(load_motion(files[clip]).motion.shape))
        if part != "train":
            held.add(shape)
        elif splits.is_open(clip):
            subject = splits.subject(clip)
            found.setdefault(shape, clip if subject == "unknown" else subject)
    return {name: list(shape) for shape, name in found.items() if shape not in held}


def _rounded(shape: Tensor) -> list[float]:
    return [round(float(x), 3) for x in shape]


def _main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--splits", type=Path, default=SPLITS)
    parser.add_argument("--to", type=Path, default=IDENTITIES)
    given = parser.parse_args()
    torch.set_num_threads(1)
    body, splits = BodyModel.load(), Splits.load(given.splits)
    files = clip_files(given.corpus)
    parts = splits.parts(list(files))
    people = _people(files, parts, splits)
    lines = [
        "# Written by benchmarks/retarget_clips.py: clip, first frame and frames at 20 Hz, body."
    ]
    lines += ["", "[people]", *(f"{json.dumps(k)} = {shape}" for k, shape in people.items())]
    for table, part in enumerate(_HELD_OUT):
        # top-level keys come first in TOML
        rows = []
        for subject in sorted({splits.subject(c) for c, p in parts.items() if p == part}):
            own = [c for c, p in parts.items() if p == part and splits.subject(c) == subject]
            usable = {row[0]: row for row in _usable(files, own, body)}
            rows += [usable[name] for name in evenly(list(usable), EACH)]
            print(f"{part} {subject}: {len(own)} clips, {len(usable)} usable")
        targets = draw_targets([row[3] for row in rows], people, SEED + table)
        listed = [json.dumps([*row[:3], to]) for row, to in zip(rows, targets, strict=True)]
        lines[1:1] = ["", f"{part} = [", *(f"    {row}," for row in listed), "]"]
    with replacing(given.to) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    _main()
