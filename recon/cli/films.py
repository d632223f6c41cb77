"""Films as inputs of verbs: detects people before the verb runs, draws pictures after it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from recon.cli import console
from recon.fitting.settings import FitSettings
from recon.formats.producers import films_at


def with_films_detected(given: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Detect people in a verb's films; return its arguments with the folder of detections.

    Args:
        given: arguments by name.
        out: the verb's output; unless another folder is given, detections are kept beside it.

    Raises:
        FileNotFoundError, ValueError: as `recon.films.reader.read_film`.
    """
    settings = given.get("settings")
    how = given if settings is None else vars(settings)
    films = films_given(given) if "detections" in how else []
    if not films or given.get("board") is not None:
        return dict(given)
    from recon.films.reader import read_film
    from recon.reading.views import check_calibrated

    if settings is not None:
        check_calibrated(films, settings)
    folder = Path(how["detections"] or out.with_name(f"{out.stem}.detections"))
    with console.progress_bars() as bars:
        for film in films:
            task = bars.add_task(film.name, total=None)
            read_film(
                film, frame_rate=how["frame_rate"], layout=how["layout"],
                detector=how["detector"], fingers=how.get("fingers", False), kept=folder,
                watch=lambda done, count, task=task: bars.update(
                    task, completed=done, total=count
                ),
            )  # fmt: skip
    if settings is None:
        return {**given, "detections": str(folder)}
    return {**given, "settings": replace(settings, detections=str(folder))}


def films_given(given: Mapping[str, Any]) -> list[Path]:
    """Return the paths of films among a verb's input files and folders."""
    paths = given.get("observations", (given.get("film"),))
    return [film for path in paths if isinstance(path, Path) for film in films_at(path)]


def draw_film_sheets(films: Sequence[Path], out: Path, settings: FitSettings) -> None:
    """Draw eight frames of every film with the fitted body over them, to OUT.sheet.png.

    An error is printed as a warning; the result is kept.

    Args:
        films: to which the result was fitted; nothing is drawn where there are none.
        out: motion file of the result, or a folder of several, each of which gets a sheet.
        settings: of the fit.
    """
    if not films:
        return
    from recon.view.files import view

    for motion in sorted(out.glob("*.npz")) if out.is_dir() else [out]:
        name = motion.stem if motion == out else f"{out.name}.{motion.stem}"
        try:
            view(
                motion, film=tuple(films), png=out.with_name(f"{name}.sheet.png"),
                frame_rate=settings.frame_rate, body=settings.body,
            )  # fmt: skip
        except Exception as error:  # a missing picture must not lose the fit
            console.print_warning(f"no sheet of moments was drawn: {error}")
