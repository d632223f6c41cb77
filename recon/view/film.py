"""Assigns films to the cameras of a motion, and reads their pictures at the motion's times."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import UInt8
from numpy import ndarray

from recon.core.errors import ObservationError, ReconError
from recon.core.motion import FilmingCamera, Motion
from recon.films.decoding import Film, open_film
from recon.formats.cameras import scale_of_images
from recon.reading.places import match_cameras, view_name
from recon.view.scene import View

_SLACK_S = 0.1
"""Time by which a film may be shorter than the motion at either end, seconds."""


@dataclass(frozen=True)
class FilmOnClock:
    """A film, and when it begins on the clock of a motion."""

    film: Film
    start_time: float
    """Time of the first picture, seconds."""

    @property
    def stop_time(self) -> float:
        """Time of the last picture, seconds."""
        return self.start_time + (self.film.frames - 1) / self.film.frame_rate

    def pictures(
        self, times: Iterable[float]
    ) -> Iterator[UInt8[ndarray, "height width 3"] | None]:
        """Yield the picture nearest to each of some rising times; None outside the film."""
        slack = 1 / self.film.frame_rate
        frames = self.film.decoded([])
        before, after = None, next(frames, None)
        for time in times:
            place = time - self.start_time
            while after is not None and after[1] <= place:
                before, after = after, next(frames, None)
            near = [one for one in (before, after) if one is not None]
            near.sort(key=lambda one: abs(one[1] - place))
            inside = self.start_time - slack <= time <= self.stop_time + slack
            yield self.film.image_of(near[0][0]) if near and inside else None


def views_of_cameras(cameras: Sequence[FilmingCamera]) -> tuple[View, ...]:
    """Convert the cameras of a motion file to views without points."""
    found: list[View] = []
    for one in cameras:
        camera, poses = one.camera, one.camera.T_camera_world
        if len(poses) == 1:
            camera = camera.replace(T_camera_world=poses[0])
        found.append(View(one.name, camera, start_time=one.start_time))
    return tuple(found)


def with_films(
    views: Sequence[View],
    films: Sequence[Path],
    motion: Motion,
    name: str,
    frame_rate: float | None = None,
) -> tuple[View, ...]:
    """Return the views that have a film, each with its film.

    Films are assigned to cameras by name, or, where names differ and there are as many of both,
    by order.

    Args:
        views: cameras of the motion.
        films: paths.
        motion: the motion that the films show.
        name: of the motion, for messages.
        frame_rate: as of `open_film`.

    Raises:
        FileNotFoundError: when there is no such film.
        ValueError: when there is no camera, or a film is damaged, belongs to none, has another
            size than its camera's images, or does not show the motion from beginning to end.
    """
    if not views:
        raise ReconError(
            f"{name}: does not say with which camera it was filmed; fit it again to the film or "
            "to 2D keypoints, or give the observation that it was fitted to with --obs"
        )
    names = [view.name for view in views]
    try:
        chosen, _ = match_cameras([view_name(path) for path in films], names)
    except ObservationError:
        if len(films) != len(views):
            raise
        chosen = names
    by_name = dict(zip(chosen, films, strict=True))
    return tuple(
        _with_film(view, open_film(by_name[view.name], frame_rate=frame_rate), motion, name)
        for view in views
        if view.name in by_name
    )


def _with_film(view: View, film: Film, motion: Motion, name: str) -> View:
    """Add a film to a camera's view, after a check of the film's size and time.

    Raises:
        ValueError: as `with_films` does.
    """
    path, size, wanted = film.path, film.image_size, view.camera.image_size
    scale = scale_of_images(wanted, size)
    if scale is None:
        raise ReconError(
            f"{path}: has images of {size[0]} x {size[1]} pixels, but those of camera {view.name} "
            f"of {name} have {wanted[0]} x {wanted[1]}; give the film that the motion was fitted "
            "to, neither cropped nor turned"
        )
    found = FilmOnClock(film, view.start_time)
    slack = max(_SLACK_S, 2 / film.frame_rate)
    before = found.start_time - motion.start_time
    after = motion.stop_time - found.stop_time
    if max(before, after) > slack:
        raise ReconError(
            f"{path}: shows {found.start_time:.2f} s to {found.stop_time:.2f} s of the clock of "
            f"{name}, which lasts from {motion.start_time:.2f} s to {motion.stop_time:.2f} s; "
            "give the whole film that the motion was fitted to"
        )
    # scale 1: the detector's images were only padded, so the camera gets the film's image size
    taken = size if (scale == 1).all() else wanted
    return replace(view, camera=view.camera.replace(image_size=taken), film=found)
