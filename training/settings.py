"""Settings of a training run, and the check that a folder holds the same run."""

import dataclasses
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.benchmark.dataset import SPLITS, Part, Splits, clip_files, is_flat
from recon.core.motion import MotionFile
from recon.formats.replacing import file_checksum, files_checksum
from training.manifest import MANIFEST, Lesson, ManifestRow, read_manifest, stretches_to_teach
from training.recordings import CorpusClip

LOG = logging.getLogger("training")
"""Logger of all trainings; its messages also stand in the log of the run."""


@dataclass(frozen=True)
class CorpusSettings:
    """The training corpus of a prior, and the output."""

    corpus: Path
    """Folder of converted motions (`python -m training.conversion`, or `recon convert --all`)."""
    out: Path
    """Weights to write; or the folder of a run that takes steps: checkpoint.pt, losses.csv,
    losses.png, train.log. A run that was interrupted goes on from its checkpoint."""
    splits: Path = SPLITS
    """Table of the subjects that are held out."""

    def files(self, part: Part) -> dict[str, Path]:
        """The motion files of one part that shipped weights may be trained on, by clip name.

        Raises:
            FileNotFoundError: when there is no splits file, or the corpus holds no motion files.
            ValueError: when two files have the same name.
        """
        files, splits = clip_files(self.corpus), Splits.load(self.splits)
        return {
            name: files[name]
            for name, own in splits.parts(list(files)).items()
            if own == part and splits.has_open_licence(name)
        }

    def stretches_that_teach(
        self, part: Part, lesson: Lesson, with_contacts: bool = True
    ) -> Iterator[tuple[str, Path, MotionFile]]:
        """Yield name, file and stretch of one part's motions that are fit for learning `lesson`.

        Without a manifest in the corpus, that is every clip as a whole, but for steps on stairs or
        slopes, where heights mean nothing.

        Raises:
            FileNotFoundError: as `files` does.
            ValueError: when the manifest is damaged, or lacks a clip.
        """
        manifest = read_manifest(self.corpus)
        for name, path in self.files(part).items():
            rows: list[ManifestRow] | None = None
            if manifest is not None:
                rows = manifest.get(name)
                if rows is None:
                    raise ValueError(
                        f"{self.corpus / MANIFEST}: lists no clip {name}; write the manifest "
                        "again by python -m training.conversion"
                    )
            elif lesson != "poses" and not is_flat(path):
                continue
            for stretch in stretches_to_teach(path, rows, lesson, with_contacts):
                yield name, path, stretch

    def load_clips(
        self, part: Part, fps: float = 30.0, lesson: Lesson = "poses"
    ) -> list[CorpusClip]:
        """Stretches of one split fit for training, resampled; single frames are dropped."""
        clips: list[CorpusClip] = []
        splits = Splits.load(self.splits)
        for name, _, file in self.stretches_that_teach(part, lesson, with_contacts=False):
            motion = file.motion.resample(fps)
            if motion.frames > 1:
                clips.append(CorpusClip(name, splits.subject(name), motion))
        LOG.info("%d %s clips, %d frames", len(clips), part, sum(c.motion.frames for c in clips))
        return clips


@dataclass(frozen=True)
class TrainingSettings(CorpusSettings):
    """Settings common to all training runs; each prior adds settings and sets defaults."""

    steps: int = 20_000
    """Steps of the optimiser."""
    rate: float = 1e-3
    """Learning rate; it falls to a hundredth along a cosine."""
    decay: float = 0.01
    """Weight decay."""
    clip: float = 1.0
    """Longest gradient."""
    average: float = 0.995
    """Share of the averaged weights kept in every step; less in the first steps."""
    validate_every: int = 500
    """Steps."""
    save_every: float = 120.0
    """Seconds."""
    seed: int = 0
    threads: int = 1


FREE = ("out", "threads", "save_every", "device")
"""Settings that may change while a run goes on: where it is written, and how fast it goes."""
_CONTENTS = "sha256:"


def plain_settings(settings: Any) -> dict[str, Any]:
    """Convert settings to a dictionary of plain values, as checkpoints store them."""
    found = dataclasses.asdict(settings)
    return {name: str(v) if isinstance(v, Path) else v for name, v in found.items()}


def settings_to_store(settings: Any) -> dict[str, Any]:
    """The settings stored in a weights file: all except paths on the training machine."""
    found = dataclasses.asdict(settings)
    return {k: v for k, v in found.items() if not isinstance(v, Path | None)}


def identity_of_run(settings: Any) -> dict[str, Any]:
    """The identity of a run: its settings, and checksums of the files they name.

    A folder counts by the motions and notes of its corpus, another file by its bytes, wherever
    they lie. Where a run is written and how fast it goes (`FREE`) is no part of it.

    Raises:
        FileNotFoundError: when a file that is named is not there.
        ValueError: when a folder holds no corpus.
    """
    found = plain_settings(settings)
    for name, value in vars(settings).items():
        if isinstance(value, Path) and name not in FREE:
            found[name] = _checksum_text(value)
    return {name: value for name, value in found.items() if name not in FREE}


def refuse_other_run(path: Path, own: dict[str, Any], found: dict[str, Any] | None) -> None:
    """Refuse to resume from the checkpoint of a run with other settings or data.

    Args:
        path: of the checkpoint, for the message.
        own: `identity_of_run` of the run that is asked for.
        found: the one in the checkpoint; None where an older version wrote none.

    Raises:
        ValueError: when they differ; the message says in what.
    """
    if found is None:
        raise ValueError(
            f"{path}: an older version wrote this checkpoint without saying what it learned "
            "from, so it cannot be continued; take another folder"
        )
    names = [name for name in (own | found) if not _same_setting(own.get(name), found.get(name))]
    if len(names) > 0:
        said = [_difference_in_words(name, found.get(name), own.get(name)) for name in names]
        raise ValueError(
            f"{path}: belongs to a run with other {', '.join(said)}; take another folder, or the "
            "settings and files of that run"
        )


def _same_setting(here: Any, there: Any) -> bool:
    """Whether two runs agree in a setting; in a table, a missing entry counts as zero.

    Parts that are added to a group of settings, such as a new variation, are zero where nothing
    changes, and checkpoints from before them hold the same run.
    """
    if isinstance(here, dict) and isinstance(there, dict):
        return all(here.get(name, 0) == there.get(name, 0) for name in here | there)
    return here == there


def _difference_in_words(name: str, there: Any, here: Any) -> str:
    if any(isinstance(value, str) and value.startswith(_CONTENTS) for value in (there, here)):
        return f"{name} (its contents differ)"
    return f"{name} ({there} there, {here} here)"


def _checksum_text(path: Path) -> str:
    if not path.is_dir():
        return _CONTENTS + file_checksum(path)
    motions = clip_files(path).values()
    notes = [motion.with_suffix(".json") for motion in motions]
    beside = [one for one in (*notes, path / MANIFEST) if one.is_file()]
    return _CONTENTS + files_checksum([*motions, *beside], path)
