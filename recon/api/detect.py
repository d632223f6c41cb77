"""`recon.detect`: the 2D keypoints of everybody in a film."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from recon.api.results import Tables, closing_fields, in_ten_lines
from recon.detections.records import Detections
from recon.detections.tables import detection_arrays
from recon.films.reader import read_film
from recon.formats.replacing import save_arrays
from recon.formats.writing import writing_file
from recon.reading.tracks import Track, tracks_of_people


@dataclass(frozen=True, repr=False)
class DetectedPeople:
    """The 2D keypoints that a detector found for everybody in a film, tracked by person."""

    detections: Detections
    """2D keypoints; people are numbered as `--person` takes them."""
    tracks: tuple[Track, ...]
    """The same by person."""

    @property
    def tables(self) -> Tables:
        """A table per person: frame count, share of keypoints seen and mean confidence."""
        rows = {
            f"person {one.number}": {
                "frames": len(one.frame),
                "from": int(one.frame[0]),
                "to": int(one.frame[-1]),
                "keypoints seen": float((one.confidence > 0).mean()),
                "confidence": float(one.confidence[one.confidence > 0].mean()),
            }
            for one in self.tracks
        }
        return {self.detections.name: rows}

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved beside the file, in plain values.

        Args:
            inputs: SHA-256 of the files that were read, by path; none by default.
            settings: how it was made, by name.
        """
        found = self.detections
        return {
            "frames": len(found.frame_numbers),
            "frame_rate": found.frame_rate,
            "image_size": found.image_size,
            "layout": found.layout,
            "people": self.tables[found.name],
            "decisions": list(found.decisions),
            **closing_fields(inputs, settings),
        }

    def save(
        self, path: Path | str, *, overwrite: bool = False, report: Mapping[str, Any] | None = None
    ) -> None:
        """Write the file (.npz) that `recon fit` reads, and its report, PATH.json.

        Args:
            path: file to write.
            overwrite: replace files that are there and recon did not write.
            report: what to write beside it instead of `report()`.

        Raises:
            FileExistsError: when either is there and recon did not write it, unless `overwrite`.
        """
        with writing_file(Path(path), report or self.report(), overwrite=overwrite) as staged:
            save_arrays(staged, detection_arrays(self.detections))

    def __repr__(self) -> str:
        """A summary of at most ten lines."""
        found = self.detections
        first = (
            f"DetectedPeople: {len(self.tracks)} in {len(found.frame_numbers)} frames of "
            f"{found.name}"
        )
        return in_ten_lines(first, [str(one) for one in self.tracks], found.decisions)


def detect(
    film: Path | str,
    *,
    frame_rate: float | None = None,
    layout: str | None = None,
    detector: str | None = None,
    fingers: bool = False,
    detections: str | None = None,
) -> DetectedPeople:
    """Detect people in a film: 33 keypoints of everybody in every frame, to look at before a fit.

    `recon fit` takes films as well as the file that this writes. People are followed past each
    other; what lies beyond the border or behind others has no or little confidence.

    Args:
        film: of one camera (.mp4, .mov, .mkv, ...).
        frame_rate: frames per second that the camera took, where the film is played slower or
            faster.
        layout: of the keypoints of a detector of your own, where their number does not tell.
        detector: the file of other landmarks of BlazePose (pose_landmark_heavy.tflite), or a
            class of your own, "package.module:Class"; None is BlazePose with landmarks `full`.
        fingers: whether hands are looked for, too, which takes half as much time again.
        detections: folder in which detections are kept, so that what was interrupted goes on.

    Raises:
        FileNotFoundError: when there is no such film.
        FormatError: when it cannot be decoded, or nobody is in it.
        ReconError: when there is no such detector, or the extra `film` is not installed.
    """
    found = read_film(
        Path(film), frame_rate=frame_rate, layout=layout, detector=detector,
        fingers=fingers, kept=None if detections is None else Path(detections),
    )  # fmt: skip
    tracks = tracks_of_people(found)
    return DetectedPeople(_with_person_numbers(found, tracks), tracks)


def _with_person_numbers(found: Detections, tracks: tuple[Track, ...]) -> Detections:
    """Return the detections of all tracks, sorted by frame, with each row's person number."""
    frame = np.concatenate([one.frame for one in tracks])
    order = np.argsort(frame, kind="stable")
    return replace(
        found,
        frame=frame[order],
        pixels=np.concatenate([one.pixels for one in tracks])[order],
        confidence=np.concatenate([one.confidence for one in tracks])[order],
        hands=_hand_points_of(tracks, order),
        identity=np.repeat([one.number for one in tracks], [len(one.frame) for one in tracks])[
            order
        ],
    )


def _hand_points_of(
    tracks: tuple[Track, ...], order: Int[np.ndarray, " rows"]
) -> Float[np.ndarray, "rows 42 3"] | None:
    hands = [one.hands for one in tracks if one.hands is not None]
    return np.concatenate(hands)[order] if hands else None
