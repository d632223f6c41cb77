"""The converted corpus in memory: clips, whose they are, and which may be learned from."""

import json
import logging
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.motion import Motion
from recon.core.skeleton import MIRROR
from recon.formats.motions import load_motion

_LOG = logging.getLogger(__name__)

SPLITS = Path(__file__).parent / "splits.toml"
"""The committed splits, and the windows of the benchmarks, which are part of the package."""

Part = Literal["train", "validation", "test", "apart"]
"""`apart`: clips of people who are tested in a row of their own, because somebody in the training
part moves like them."""
Listed = tuple[tuple[str, float], ...]
"""Windows: clip, and first second from the clip's first frame."""
Licence = Literal["open", "nc"]
"""Clips that weights in an open package may learn from, or those for non-commercial use too."""


@dataclass(frozen=True)
class Splits:
    """The parts of the corpus (training, validation, test), decided by clip names alone."""

    subjects: dict[str, tuple[str, ...]]
    """Name patterns of the clips of each subject, the first that matches counts; a clip of no
    pattern belongs to the subject its name begins with (`07_01`: 07; `anna/walk_1`: anna)."""
    test: tuple[str, ...]
    apart: tuple[str, ...]
    """Subjects who are tested, but left out of means over the test subjects."""
    validation: tuple[str, ...]
    every_tenth: tuple[str, ...]
    """Patterns of clips that give every tenth to validation where they are not test clips."""
    non_commercial: tuple[str, ...]
    """Patterns of clips whose licence forbids commercial use."""
    excluded: tuple[str, ...]
    """Clips in no part."""
    windows: dict[str, dict[int, Listed]]
    """Listed windows by part ("test" or "validation") and by their number of frames at 30 Hz.
    Those of subjects apart are listed with the test windows."""

    @classmethod
    def load(cls, path: str | Path = SPLITS) -> "Splits":
        """Read the committed table.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is no such table.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no splits there; expected a file like {SPLITS}")
        try:
            table: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
            return cls(
                subjects={name: tuple(rows) for name, rows in table["subjects"].items()},
                test=tuple(table["test"]["subjects"]),
                apart=tuple(table["test"].get("apart", ())),
                validation=tuple(table["validation"]["subjects"]),
                every_tenth=tuple(table["validation"]["every_tenth"]),
                non_commercial=tuple(table["licence"]["non_commercial"]),
                excluded=tuple(table["excluded"]["clips"]),
                windows={
                    part: {
                        int(frames): tuple((str(clip), float(start)) for clip, start in rows)
                        for frames, rows in lengths.items()
                    }
                    for part, lengths in table.get("windows", {}).items()
                },
            )
        except (tomllib.TOMLDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
            raise ValueError(
                f"{path}: expected splits as in recon/benchmark/splits.toml: {error!r}"
            ) from error

    def subject(self, clip: str) -> str:
        """The subject of a clip."""
        for name, patterns in self.subjects.items():
            if _matches(clip, patterns):
                return name
        return clip.split("/" if "/" in clip else "_", 1)[0]

    def is_open(self, clip: str) -> bool:
        """Weights that learned from it may go into an open package."""
        return not _matches(clip, self.non_commercial)

    def parts(self, clips: Sequence[str]) -> dict[str, Part]:
        """The part of every clip of the whole corpus; excluded clips are left out.

        Every tenth is counted in the order of names, from the first.
        """
        kept = sorted(set(clips) - set(self.excluded))
        held_out: dict[str, Part] = {}
        for clip in kept:
            subject = self.subject(clip)
            if subject in self.test:
                held_out[clip] = "test"
            elif subject in self.apart:
                held_out[clip] = "apart"
            elif subject in self.validation:
                held_out[clip] = "validation"
        counted = [c for c in kept if c not in held_out and _matches(c, self.every_tenth)]
        held_out |= dict.fromkeys(counted[::10], "validation")
        return {clip: held_out.get(clip, "train") for clip in kept}


@dataclass(frozen=True)
class CorpusClip:
    """One recording on our body."""

    name: str
    subject: str
    motion: Motion


def clip_files(corpus: str | Path) -> dict[str, Path]:
    """The motion files of a converted corpus by clip name, in the order of names.

    Raises:
        FileNotFoundError: when the folder holds none.
        ValueError: when two files have the same name.
    """
    found: dict[str, Path] = {}
    for name, path in sorted((_name(path), path) for path in Path(corpus).rglob("*.npz")):
        if name in found:
            raise ValueError(f"two clips are called {name}: {found[name]} and {path}")
        found[name] = path
    if len(found) == 0:
        raise FileNotFoundError(
            f"{corpus}: no motion files (.npz) there; make them by recon convert --all"
        )
    return found


def notes(motion: Path) -> dict[str, Any]:
    """What the conversion noted in the file beside a motion; empty where there is none.

    Raises:
        ValueError: when that file is no JSON.
    """
    beside = motion.with_suffix(".json")
    try:
        noted = json.loads(beside.read_text(encoding="utf-8")) if beside.is_file() else None
    except ValueError as error:
        raise ValueError(
            f"{beside}: expected the notes of recon convert --all, got no JSON ({error})"
        ) from error
    return noted if isinstance(noted, dict) else {}


def _name(motion: Path) -> str:
    """A clip's name as the conversion noted it, folders included; else that of its file."""
    name = notes(motion).get("clip")
    return name if isinstance(name, str) else motion.stem


def files_of(corpus: str | Path, splits: Splits, part: Part, licence: Licence) -> dict[str, Path]:
    """The motion files of one part by clip name, those that the licence allows.

    Raises:
        FileNotFoundError: when the folder holds no motion files.
        ValueError: when two files have the same name.
    """
    files = clip_files(corpus)
    return {
        name: files[name]
        for name, own in splits.parts(list(files)).items()
        if own == part and (licence == "nc" or splits.is_open(name))
    }


def files_on_flat_ground(
    corpus: str | Path, splits: Splits, part: Part, licence: Licence
) -> dict[str, Path]:
    """`files_of` without the clips on stairs or slopes, where heights mean nothing."""
    files = files_of(corpus, splits, part, licence)
    return {name: path for name, path in files.items() if is_flat(path)}


def load_clips(
    corpus: str | Path, splits: Splits, part: Part, licence: Licence = "open", fps: float = 30.0
) -> list[CorpusClip]:
    """All clips of one part, resampled; those of one frame only are skipped."""
    clips: list[CorpusClip] = []
    for name, path in files_of(corpus, splits, part, licence).items():
        motion = load_motion(path).motion.resample(fps)
        if motion.frames > 1:
            clips.append(CorpusClip(name, splits.subject(name), motion))
    _LOG.info("%d %s clips, %d frames", len(clips), part, sum(c.motion.frames for c in clips))
    return clips


def is_flat(path: Path) -> bool:
    """Whether the notes of the conversion beside a clip say flat ground; without notes, yes."""
    return bool(notes(path).get("flat", True))


def mirrored(motion: Motion) -> Motion:
    """The motion as a mirror at the plane x = 0 shows it: left and right exchanged.

    With S = diag(-1, 1, 1), rotations become S R S of the counterpart; bodies are symmetric.
    """
    flip = motion.translation.new_tensor([-1.0, 1.0, 1.0])
    return motion.replace(
        translation=motion.translation * flip, rotations=mirrored_rotations(motion.rotations)
    )


def mirrored_rotations(
    rotations: Float[Tensor, "*shape 22 3 3"],
) -> Float[Tensor, "*shape 22 3 3"]:
    """Rotations of the mirrored pose."""
    flip = rotations.new_tensor([-1.0, 1.0, 1.0])
    return (flip[:, None] * rotations * flip)[..., list(MIRROR), :, :]


def poses(clips: Sequence[CorpusClip], rate: float, most: int) -> Float[Tensor, "poses 22 3 3"]:
    """Poses of all clips, `rate` of them per second, evenly spaced, each with its mirror image.

    No subject gives more than about `most` (before mirroring), taken evenly from all its clips:
    whoever was recorded for an hour must not decide alone what a pose is.
    """
    by_subject: dict[str, list[Tensor]] = {}
    for clip in clips:
        step = max(1, round(clip.motion.fps / rate))
        by_subject.setdefault(clip.subject, []).append(clip.motion.rotations[::step])
    rows = [torch.cat(own) for own in by_subject.values()]
    together = torch.cat([row[:: -(-len(row) // most)] for row in rows])
    return torch.cat((together, mirrored_rotations(together)))


def _matches(clip: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(clip, pattern) for pattern in patterns)
