"""Detects people in the films that a verb is given, with progress, before it reads them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from recon.cli import console
from recon.formats.producers import is_film


def with_films_detected(given: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """A verb's arguments with the folder in which it finds the detections of its films.

    Args:
        given: arguments by name.
        out: the verb's output; unless another folder is given, detections are kept beside it.

    Raises:
        FileNotFoundError, ValueError: as `recon.films.reader.read_film`.
    """
    paths = given.get("observations", (given.get("film"),))
    films = [path for path in paths if isinstance(path, Path) and is_film(path)]
    if not films:
        return dict(given)
    from recon.films.reader import read_film

    settings = given.get("settings")
    how = given if settings is None else vars(settings)
    folder = Path(how["detections"] or out.with_name(f"{out.stem}.detections"))
    with console.progress_bars() as bars:
        for film in films:
            task = bars.add_task(film.name, total=None)
            read_film(
                film, frame_rate=how["frame_rate"], layout=how["layout"],
                detector=how["detector"], kept=folder,
                watch=lambda done, count, task=task: bars.update(
                    task, completed=done, total=count
                ),
            )  # fmt: skip
    if settings is None:
        return {**given, "detections": str(folder)}
    return {**given, "settings": replace(settings, detections=str(folder))}
