"""Holds out people one at a time, and the clips that the other people's priors learn from."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.benchmark.dataset import Splits, clip_files
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS
from recon.formats.motions import load_motion

SHORT = 20.0
"""Total duration (s) of a person's recordings below which people are held out together."""
GROUP = "short"
"""Name of the fold of all people with short recordings."""
UNKNOWN = "unknown"
"""Subject of clips whose person is unknown."""
NEAR = 6.0
"""Distance (degrees) below which a clip of unknown people may show a given person. Takes of one
walker lie within 3.8 degrees of each other; no other person comes nearer to test subject 07 than
6."""
_RATE_HZ = 10.0
"""Frame rate (Hz) at which motions are compared."""

Directions = Float[Tensor, "frames 21 3"]


@dataclass(frozen=True)
class Fold:
    """People who are held out together, and the parts of the corpus meanwhile."""

    name: str
    people: tuple[str, ...]
    splits: Splits
    """Parts of the corpus: they are validation, everybody else outside test is training."""


def folds(seconds: Mapping[str, float], splits: Splits) -> tuple[Fold, ...]:
    """Return a fold for everybody outside test, and one for people with less than `SHORT` seconds.

    Clips of unknown people belong to no fold, and those for non-commercial use are left out.

    Args:
        seconds: duration of every clip of the corpus.
        splits: test people, and clips of unknown people.
    """
    recorded: dict[str, float] = {}
    for clip, part in splits.parts(list(seconds)).items():
        person = splits.subject(clip)
        if part in ("train", "validation") and person != UNKNOWN and splits.has_open_licence(clip):
            recorded[person] = recorded.get(person, 0.0) + seconds[clip]
    alone = sorted(person for person, total in recorded.items() if total >= SHORT)
    together = tuple(sorted(set(recorded) - set(alone)))
    held_out = [(person, (person,)) for person in alone]
    held_out += [(GROUP, together)] if together else []
    return tuple(Fold(name, people, _without(splits, people)) for name, people in held_out)


def _without(splits: Splits, people: tuple[str, ...]) -> Splits:
    return replace(splits, validation=people, every_tenth=(), windows={})


def without_doubles(fold: Fold, motions: Mapping[str, Directions]) -> Fold:
    """Return the fold without clips of unknown people that may show its own people.

    Excluded are clips that are nearer to one of them than `NEAR` degrees.

    Args:
        fold: the held-out people.
        motions: directions of bones of every clip.
    """
    parts = fold.splits.parts(list(motions))
    own = [motions[clip] for clip, part in parts.items() if part == "validation"]
    unknown = [clip for clip in parts if fold.splits.subject(clip) == UNKNOWN]
    near = [clip for clip in unknown if distance(motions[clip], torch.cat(own)) < NEAR]
    excluded = (*fold.splits.excluded, *near)
    return replace(fold, splits=replace(fold.splits, excluded=excluded))


def directions(motion: Motion, body: BodyModel) -> Directions:
    """Return unit vectors of all bones at 10 Hz, turned about z so that the body faces x."""
    some = motion.resample(_RATE_HZ)
    joints = body.pose(some).joints
    bones = joints[:, 1:] - joints[:, list(PARENTS[1:])]
    bones = bones / bones.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    ahead = some.rotations[:, 0, :, 2]
    turn = so3.about_z(-torch.atan2(ahead[:, 1], ahead[:, 0]))
    return (turn[:, None] @ bones[..., None])[..., 0].double()


def distance(clip: Directions, others: Directions) -> float:
    """Return the median over a clip's frames of the mean bone angle to the nearest other frame."""
    nearest = [
        torch.einsum("bi,fbi->fb", frame, others).clamp(-1, 1).acos().mean(1).min()
        for frame in clip
    ]
    return float(np.degrees(torch.stack(nearest).median().item()))


def corpus_folds(
    corpus: Path, splits: Splits, body: BodyModel, names: Sequence[str] | None = None
) -> tuple[Fold, ...]:
    """Return the folds of a corpus, or those of some names in that order, without doubles.

    Raises:
        ValueError: when there is no fold of a name.
    """
    files = clip_files(corpus)
    motions = {
        clip: load_motion(files[clip]).motion
        for clip, part in splits.parts(list(files)).items()
        if part in ("train", "validation") and splits.has_open_licence(clip)
    }
    found = {fold.name: fold for fold in folds(_seconds(motions), splits)}
    chosen = list(found) if names is None else list(names)
    if spare := [name for name in chosen if name not in found]:
        raise ValueError(f"expected folds out of {', '.join(found)}, got {', '.join(spare)}")
    seen = {clip: directions(motion, body) for clip, motion in motions.items()}
    return tuple(without_doubles(found[name], seen) for name in chosen)


def _seconds(motions: Mapping[str, Motion]) -> dict[str, float]:
    return {clip: motion.frames / motion.fps for clip, motion in motions.items()}


def write_splits(splits: Splits, path: Path) -> Path:
    """Write splits as a table that `Splits.load` reads, without their windows."""
    tables = {
        "subjects": splits.subjects,
        "test": {"subjects": splits.test, "apart": splits.apart},
        "validation": {"subjects": splits.validation, "every_tenth": splits.every_tenth},
        "licence": {"non_commercial": splits.non_commercial},
        "excluded": {"clips": splits.excluded},
    }
    lines = ["# Written by benchmarks.strangers."]
    for title, rows in tables.items():
        lines += ["", f"[{title}]"]
        lines += [f"{json.dumps(name)} = {json.dumps(value)}" for name, value in rows.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
