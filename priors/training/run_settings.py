"""Settings of a training run in its files, and whether a folder holds that same run."""

import dataclasses
from enum import Enum
from pathlib import Path
from typing import Any

from priors.training.dataset import clip_files
from recon.formats.files.checksums import file_checksum, files_checksum

FREE = ("out", "threads", "save_every", "device")
"""Settings that may change while a run goes on: where it is written, and how fast it goes."""
_CONTENTS = "sha256:"


def plain(settings: Any) -> dict[str, Any]:
    """A dataclass of settings as JSON holds it."""
    return {name: _plain(value) for name, value in dataclasses.asdict(settings).items()}


def told_settings(settings: Any) -> dict[str, Any]:
    """The settings of a run that a weights file tells: all but places on the trainer's disk."""
    return {
        k: v for k, v in plain(settings).items() if k not in ("corpus", "out", "splits", "warm")
    }


def identity(settings: Any) -> dict[str, Any]:
    """All that decides what a run learns: its settings, and the contents of the files they name.

    A folder counts by the motions and notes of its corpus, another file by its bytes, wherever
    they lie. Where a run is written and how fast it goes (`FREE`) is no part of it.

    Raises:
        FileNotFoundError: when a file that is named is not there.
        ValueError: when a folder holds no corpus.
    """
    found = plain(settings)
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, Path) and field.name not in FREE:
            found[field.name] = _contents(value)
    return {name: value for name, value in found.items() if name not in FREE}


def same_run(path: Path, own: dict[str, Any], found: dict[str, Any] | None) -> None:
    """Refuse to go on with a checkpoint of a run that learns something else.

    Args:
        path: of the checkpoint, for the message.
        own: `identity` of the run that is asked for.
        found: the one in the checkpoint; None where an older version wrote none.

    Raises:
        ValueError: when they differ; the message says in what.
    """
    if found is None:
        raise ValueError(
            f"{path}: an older version wrote this checkpoint without saying what it learned "
            "from, so it cannot be continued; take another folder"
        )
    names = [name for name in (own | found) if not _same(own.get(name), found.get(name))]
    if len(names) > 0:
        said = [_difference(name, found.get(name), own.get(name)) for name in names]
        raise ValueError(
            f"{path}: a run with other {', '.join(said)}; take another folder, or the settings "
            "and files of that run"
        )


def _same(here: Any, there: Any) -> bool:
    """Whether a setting is the same; a part that is zero counts as one that is not there.

    Parts that are added to a group of settings, such as a new variation, are zero where nothing
    changes, and checkpoints from before them hold the same run.
    """
    if isinstance(here, dict) and isinstance(there, dict):
        return all(here.get(name, 0) == there.get(name, 0) for name in here | there)
    return here == there


def _difference(name: str, there: Any, here: Any) -> str:
    if any(isinstance(value, str) and value.startswith(_CONTENTS) for value in (there, here)):
        return f"{name} (its contents differ)"
    return f"{name} ({there} there, {here} here)"


def _contents(path: Path) -> str:
    if not path.is_dir():
        return _CONTENTS + file_checksum(path)
    motions = clip_files(path).values()
    notes = [motion.with_suffix(".json") for motion in motions]
    return _CONTENTS + files_checksum([*motions, *(n for n in notes if n.is_file())], path)


def _plain(value: Any) -> Any:
    match value:
        case Path():
            return str(value)
        case Enum():
            return value.value
        case tuple():
            return list(value)
        case _:
            return value
