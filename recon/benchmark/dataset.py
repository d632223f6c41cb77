"""Lists the clips of a converted corpus, with subjects and parts (training, test, ...)."""

import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

SPLITS = Path(__file__).parent / "splits.toml"
"""The committed splits, and the windows of the benchmarks, which are part of the package."""

Part = Literal["train", "validation", "test", "apart"]
"""`apart`: clips of people who are tested in a row of their own, because somebody in the training
part moves like them."""
Listed = tuple[tuple[str, float], ...]
"""Windows: clip, and first second from the clip's first frame."""


@dataclass(frozen=True)
class Splits:
    """The split of a corpus into training, validation and test, by clip names alone."""

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
    """Patterns of clips in no part."""
    windows: dict[str, dict[int, Listed]]
    """Listed windows by part ("test" or "validation") and by their number of frames at 30 Hz.
    Those of subjects apart are listed with the test windows; "strangers" are those of test people
    of another laboratory."""

    @classmethod
    def load(cls, path: str | Path = SPLITS) -> "Splits":
        """Read the split from a TOML file.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it is no such table.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such file; expected one like {SPLITS}")
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
        """Return the person in a clip: by the table of subjects, else by the clip's name."""
        for name, patterns in self.subjects.items():
            if _matches(clip, patterns):
                return name
        return clip.split("/" if "/" in clip else "_", 1)[0]

    def has_open_licence(self, clip: str) -> bool:
        """Whether weights trained on a clip may be published under an open licence."""
        return not _matches(clip, self.non_commercial)

    def parts(self, clips: Sequence[str]) -> dict[str, Part]:
        """Return the part (train, validation, test, apart) of every clip that is not excluded.

        Of some clips every tenth is for validation, in the order of names, from the first.
        """
        kept = sorted(clip for clip in set(clips) if not _matches(clip, self.excluded))
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


def clip_files(corpus: str | Path) -> dict[str, Path]:
    """The motion files of a converted corpus, keyed and sorted by clip name.

    Raises:
        FileNotFoundError: when the folder holds none.
        ValueError: when two files have the same name.
    """
    found: dict[str, Path] = {}
    for name, path in sorted((_clip_name(path), path) for path in Path(corpus).rglob("*.npz")):
        if name in found:
            raise ValueError(
                f"expected different names of clips, got {name} for {found[name]} and {path}; "
                "rename one"
            )
        found[name] = path
    if len(found) == 0:
        raise FileNotFoundError(
            f"{corpus}: no motion files (.npz) there; make them by recon convert --all"
        )
    return found


def conversion_notes(motion: Path) -> dict[str, Any]:
    """Read the .json file that `recon convert` wrote beside a motion; {} without such a file.

    Raises:
        ValueError: when that file is no JSON.
    """
    path = motion.with_suffix(".json")
    try:
        noted = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
    except ValueError as error:
        raise ValueError(
            f"{path}: expected JSON notes of recon convert --all, but it is damaged ({error})"
        ) from error
    return noted if isinstance(noted, dict) else {}


def _clip_name(motion: Path) -> str:
    """Return a clip's name from the notes beside its motion file, else the file's stem."""
    name = conversion_notes(motion).get("clip")
    return name if isinstance(name, str) else motion.stem


def is_flat(path: Path) -> bool:
    """Whether the notes beside a clip say that the ground is flat; true without notes."""
    return bool(conversion_notes(path).get("flat", True))


def _matches(clip: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(clip, pattern) for pattern in patterns)
