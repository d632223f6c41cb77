"""Reads films: detects and follows people from frame to frame, and returns their 2D keypoints."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import FormatError, ReconError
from recon.core.plugins import DETECTORS, imported_object, registered_places
from recon.detections.records import Background, Detections, Row, detections_of_rows
from recon.detections.tables import detection_arrays, read_detection_arrays
from recon.films.background import FollowedPoints, points_if_camera_moves
from recon.films.blazepose import BlazePose
from recon.films.clock import resampled_at_even_times
from recon.films.decoding import Film, FilmFrame, open_film
from recon.films.hand_networks import HandNetworks
from recon.films.hands import with_hands
from recon.films.sides import rows_of_sights
from recon.films.tracking import Sight, Tracker
from recon.films.unfinished import Unfinished
from recon.films.vertical import straight_segments
from recon.formats.opening import existing_file, load_arrays
from recon.formats.replacing import file_checksum, save_arrays, value_checksum

Watch = Callable[[int, int], None]
"""A function that is called with the number of frames read so far and the number of all frames."""
Detector = Callable[[Iterable[FilmFrame]], Iterable[Row]]
"""A function from frames to rows, one per person and frame: frame number, x, y (pixels of the
image) and confidence of every keypoint, and the person's number or -1."""
_VERSION = 5
"""Raised when the same film gives other detections, so that stored ones are computed again."""
_HANDS_VERSION = "hands 1"
"""Changed when the same film gives other points of hands, so that these are computed again."""
_NETWORK = ".tflite"
_SAVED_EVERY = 500
"""Frames after which detections are saved, so that an interrupted run can go on."""
_IMAGES_WITH_LINES = 5
"""Number of images of a film in which straight lines are looked for."""


@dataclass(frozen=True)
class _StoreFile:
    """The file in a user's folder that stores the detections of a film."""

    film: Path
    folder: Path
    key: str
    """Checksum of everything that the detections depend on."""

    @property
    def file(self) -> Path:
        return self.folder / f"{self.film.stem}-{self.key[:8]}.npz"

    def load(self) -> Detections | None:
        """Return the stored detections; None where there are none, or they have another key."""
        if not self.file.is_file():
            return None
        arrays = load_arrays(self.file)
        if str(arrays.get("made_of")) != self.key:
            return None
        seen, notes = read_detection_arrays(self.file), arrays["notes"].tolist()
        more = (note for note in seen.decisions if note not in notes)
        return replace(seen, name=self.film.name, decisions=(*notes, *more))

    def save(self, found: Detections, notes: Sequence[str]) -> None:
        """Save detections, and notes that are not made again when the file is read."""
        self.folder.mkdir(parents=True, exist_ok=True)
        arrays = {"made_of": np.array(self.key), "notes": np.array(notes, str)}
        save_arrays(self.file, {**detection_arrays(found), **arrays})


def read_film(
    path: Path,
    *,
    frame_rate: float | None = None,
    layout: str | None = None,
    detector: str | None = None,
    fingers: bool = False,
    kept: Path | None = None,
    watch: Watch | None = None,
) -> Detections:
    """Detect the 2D keypoints of all people in a film.

    Hands are looked for in a second pass, at the wrists that the first one found.

    Args:
        path: file of the film.
        frame_rate: pictures per second that the camera took, where the film does not tell.
        layout: of the keypoints of a detector of your own, where their number does not tell.
        detector: None is BlazePose with its network `full` for landmarks; else the file of another
            of these networks (.tflite), a registered name or "package.module:Class" (`Detector`).
        fingers: whether hands are looked for, too, where the detector does not find them itself.
        kept: folder in which detections are stored, so that the next call finds them, or goes on
            where this one is interrupted; None stores nothing.
        watch: called with the progress.

    Raises:
        FileNotFoundError: when there is no such film.
        FormatError: when the film cannot be decoded or shows nobody.
        ReconError: when the detector is not installed.
    """
    existing_file(path)
    key = "" if kept is None else _detections_checksum(path, frame_rate, layout, detector)
    people = None if kept is None else _StoreFile(path, kept, key)
    if not fingers:
        return _detections_without_hands(path, frame_rate, layout, detector, people, watch)
    both = None if kept is None else _StoreFile(path, kept, value_checksum([key, _HANDS_VERSION]))
    if both is not None and (found := both.load()) is not None:
        return found
    networks = HandNetworks()
    found = _detections_without_hands(path, frame_rate, layout, detector, people, watch)
    if found.hands is None:
        film = open_film(path, frame_rate=frame_rate)
        found = with_hands(film, _with_progress(film, watch), found, networks)
        if both is not None:
            both.save(found, found.decisions)
    return found


def _with_progress(film: Film, watch: Watch | None) -> Iterator[FilmFrame]:
    """Yield the frames of a film, and call `watch` after each of them."""
    for frame in film:
        yield frame
        if watch is not None:
            watch(frame.number + 1, film.frames)


def _detections_without_hands(
    path: Path,
    frame_rate: float | None,
    layout: str | None,
    detector: str | None,
    kept: _StoreFile | None,
    watch: Watch | None,
) -> Detections:
    """Do the first pass of `read_film`, which finds hands only if the detector does so itself."""
    if kept is not None and (found := kept.load()) is not None:
        return found
    film = open_film(path, frame_rate=frame_rate)
    frames = _WatchedFilm(film, watch)
    unfinished = None
    if detector is None or detector.endswith(_NETWORK):
        networks = BlazePose(None if detector is None else Path(detector))
        if kept is not None:
            folder = kept.file.with_name(f"{kept.file.stem}-unfinished")
            unfinished = Unfinished(folder, kept.key)
        sights = sorted(
            _detect_everybody(frames, film.frame_rate, networks, unfinished),
            key=lambda one: one.track,
        )
        people = [
            rows_of_sights(list(seen)) for _, seen in groupby(sights, key=lambda one: one.track)
        ]
        layout = "mediapipe33"
    else:
        rows = sorted(_detector_named(detector)(frames), key=lambda row: row[2])
        people = [list(own) for _, own in groupby(rows, key=lambda row: row[2])]
    lines, lines_frame = frames.lines()
    found = _detections(film, frames.times, people, layout)
    background, note = points_if_camera_moves(frames.background(), found)
    film.notes += [note] if note else []
    found = replace(
        found, lines=lines, lines_frame=lines_frame, background=background,
        decisions=(*([note] if note else []), *found.decisions),
    )  # fmt: skip
    if kept is not None:
        kept.save(found, film.notes)
        if unfinished is not None:
            unfinished.remove()
    return found


@dataclass
class _WatchedFilm:
    """Iterates over a film's frames; reports progress, records times, lines and background."""

    film: Film
    watch: Watch | None
    times: dict[int, float] = field(default_factory=dict)
    segments: dict[int, tuple[int, Float[np.ndarray, "segments 2 2"]]] = field(
        default_factory=dict
    )
    """Shot and straight segments (ends in pixels of the film) of some frames, by frame number."""
    followed: FollowedPoints = field(default_factory=FollowedPoints)

    def __iter__(self) -> Iterator[FilmFrame]:
        every = max(1, self.film.frames // _IMAGES_WITH_LINES)
        for frame in _with_progress(self.film, self.watch):
            if frame.number % every == every // 2:
                ends = self.film.in_film(straight_segments(frame.image))
                self.segments[frame.number] = frame.shot, ends
            self.followed.follow(frame.image, frame.number, frame.shot)
            yield frame
            self.times[frame.number] = frame.time

    def lines(self) -> tuple[Float[np.ndarray, "lines 2 2"], Int[np.ndarray, " lines"]]:
        """Return straight segments of the shot with most searched frames, and each one's frame."""
        shots = Counter(shot for shot, _ in self.segments.values())
        chosen = shots.most_common(1)[0][0] if shots else 0
        own = {n: ends for n, (shot, ends) in self.segments.items() if shot == chosen}
        count = [len(ends) for ends in own.values()]
        ends = np.concatenate([np.zeros((0, 2, 2)), *own.values()])
        return ends, np.repeat(np.array(list(own), dtype=np.int64), count)

    def background(self) -> Background:
        """Return all points that were followed through the film, in pixels of the film."""
        it = self.followed
        pixels = np.concatenate([np.zeros((0, 2)), *it.pixels])
        frames, numbers = (
            np.concatenate([np.zeros(0, np.int64), *own]) for own in (it.frames, it.numbers)
        )
        return Background(frames, numbers, self.film.in_film(pixels))


def _detect_everybody(
    frames: Iterable[FilmFrame], rate: float, networks: BlazePose, unfinished: Unfinished | None
) -> list[Sight]:
    """Detect all people in every frame; save what was found if the run is interrupted."""
    tracker = Tracker(networks, rate)
    sights, state = ([], None) if unfinished is None else unfinished.load()
    if state is not None:
        tracker.continue_from(state)
    after = -1 if state is None else state.frame
    kept, done = len(sights), False
    try:
        for count, frame in enumerate(frames, start=1):
            if frame.number <= after:
                continue
            sights += tracker.detect_next(frame.image, frame.number, frame.shot)
            state = tracker.state()
            if unfinished is not None and count % _SAVED_EVERY == 0:
                unfinished.add(sights[kept:], kept, state)
                kept = len(sights)
        done = True
    finally:
        if unfinished is not None and state is not None and not done:
            # leave out detections of a frame in which the tracker was interrupted
            unfinished.add([one for one in sights[kept:] if one.frame <= state.frame], kept, state)
    return sights


def _detections(
    film: Film, times: Mapping[int, float], people: list[list[Row]], layout: str | None
) -> Detections:
    """Convert rows of people to detections at even times, in pixels of the film before shrinking.

    Keypoints beyond the image's border are guesses: they get a confidence of 0.
    """
    numbers = list(times)
    if not film.clock.is_even:
        numbers = list(range(film.frames))
        people = [
            resampled_at_even_times(own, times, film.frame_rate) if _is_one_person(own) else own
            for own in people
        ]
    rows = sorted((row for own in people for row in own), key=lambda row: row[0])
    if not rows:
        raise FormatError(
            f"{film.path}: nobody was found in any of its {film.frames} frames; a person should "
            "be seen from head to foot and be at least a tenth of the image high"
        )
    scaled: list[Row] = []
    for number, points, person in rows:
        pixels = film.in_film(points[:, :2])
        inside = ((pixels >= 0) & (pixels <= np.array(film.image_size) - 1)).all(1)
        seen = np.where(inside, points[:, 2], 0.0)
        scaled.append((number, np.column_stack((pixels, seen)), person))
    found = detections_of_rows(
        film.path.name, numbers, scaled, layout=layout, decisions=tuple(film.notes)
    )
    return replace(
        found, frame_rate=film.frame_rate, image_size=film.image_size, shots=film.shots,
        stated_focal=film.stated_focal,
    )  # fmt: skip


def _is_one_person(rows: list[Row]) -> bool:
    """Return whether rows can be of one person, that is, no frame occurs twice."""
    return len({number for number, _, _ in rows}) == len(rows)


def _detector_named(name: str) -> Detector:
    """Make the detector that a caller chose by a registered name or package.module:Class.

    Raises:
        ReconError: when there is no detector of this name.
    """
    known = registered_places(DETECTORS)
    if name not in known and ":" not in name:
        raise ReconError(
            f"detector: expected a file of BlazePose's landmark network ({_NETWORK}), a "
            f"class package.module:Class{''.join(f', {one}' for one in known)}; got {name!r}"
        )
    return imported_object(known.get(name, name), "detector")()


def _detections_checksum(
    path: Path, frame_rate: float | None, layout: str | None, detector: str | None
) -> str:
    """Return a checksum of everything that the detections of a film depend on."""
    network = detector is not None and detector.endswith(_NETWORK)
    return value_checksum(
        [
            _VERSION,
            file_checksum(path),
            frame_rate,
            layout,
            file_checksum(existing_file(Path(detector))) if network and detector else detector,
        ]
    )
