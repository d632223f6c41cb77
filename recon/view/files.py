"""Motion and observation files as a show, drawn to files: what `recon view` does."""

from pathlib import Path

import torch

from observations.files import load
from recon.body import BodyModel
from recon.formats.amass import MotionFile, load_motion
from recon.motion import Motion
from recon.protocols import Estimate
from recon.view.scene import GREY, Figure, Points, Show


def view_files(
    motion: Path,
    *,
    obs: Path | None = None,
    compare: Path | None = None,
    html: Path | None = None,
    png: Path | None = None,
    mp4: Path | None = None,
) -> None:
    """Draw a motion, with the points it was fitted to and another motion if given.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when one is damaged, or the motions do not overlap in time.
    """
    body = BodyModel.load()
    file = load_motion(motion)
    figures = [Figure(body, file.motion, motion.stem, contacts=file.contacts)]
    if compare is not None:
        other = _meanwhile(load_motion(compare), file.motion, compare)
        name = compare.stem if compare.stem != motion.stem else f"{compare.stem} (2)"
        figures.append(Figure(body, other, name, colour=GREY, opacity=0.45))
    points = None if obs is None else _points(obs, file.motion, body)
    show = Show(motion.stem, tuple(figures), points)
    if html is not None:
        from recon.view.html import write_html

        write_html(html, show)
    if png is not None:
        from recon.view.frames import write_png

        write_png(png, [show])
    if mp4 is not None:
        from recon.view.frames import write_mp4

        write_mp4(mp4, show)


def _meanwhile(file: MotionFile, motion: Motion, path: Path) -> Motion:
    """Another motion at the times of the first."""
    try:
        return file.motion.at(motion.times, motion.fps)
    except ValueError as error:
        raise ValueError(f"{path}: cannot be compared: {error}") from error


def _points(path: Path, motion: Motion, body: BodyModel) -> Points:
    observation = load(path, body)
    moments = torch.arange(observation.positions.shape[1], dtype=torch.float64)
    points = Points(observation.positions[0], observation.visible[0]).on(
        motion.times, observation.start_time + moments / observation.fps
    )
    estimate = Estimate.of_clip(motion, body)
    return Points(points.positions, points.visible, observation.predict(estimate)[0])
