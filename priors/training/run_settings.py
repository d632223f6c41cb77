"""Settings of a training run in its files, and whether a folder holds that run."""

import dataclasses
from collections.abc import Collection
from enum import Enum
from pathlib import Path
from typing import Any


def plain(settings: Any) -> dict[str, Any]:
    """A dataclass of settings as JSON holds it."""
    return {name: _plain(value) for name, value in dataclasses.asdict(settings).items()}


def same_run(path: Path, settings: Any, found: dict[str, Any], fixed: Collection[str]) -> None:
    """Refuse to go on with a checkpoint of other settings.

    Args:
        path: of the checkpoint, for the message.
        settings: asked for.
        found: what the checkpoint says of its own.
        fixed: names of settings that a run keeps.

    Raises:
        ValueError: when one of them differs.
    """
    own = plain(settings)
    changed = [name for name in own if name in fixed and own[name] != found.get(name)]
    if len(changed) > 0:
        raise ValueError(
            f"{path}: a run with other {', '.join(changed)}; take another folder, or the "
            "settings of that run"
        )


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
