"""Stores detections of a film while it is read, so that an interrupted run can go on."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.films.blazepose import LANDMARKS, Pose, Region
from recon.films.tracking import Sight, TrackerState
from recon.formats.opening import load_arrays
from recon.formats.replacing import save_arrays

_SIZES = (2 * LANDMARKS, LANDMARKS, LANDMARKS, LANDMARKS, 1, 2, 1, 1, 4)
"""Lengths of a pose's fields in an array: pixels, visibility, presence, inside, score, the centre,
side and angle of the region, and points of the next one."""


@dataclass(frozen=True)
class Unfinished:
    """A folder with partial results of a film: detections, and the state of the tracker."""

    folder: Path
    key: str
    """Checksum of everything that the detections depend on."""

    def add(self, sights: list[Sight], before: int, state: TrackerState) -> None:
        """Save the next part of the detections, from which an interrupted run goes on.

        Args:
            sights: detections that no part has yet.
            before: number of detections in all parts before; a part with as many before it is
                replaced.
            state: of the tracker after the last frame of this part.
        """
        rows = [(*_numbers_of_pose(one.pose), *_numbers_of_pose(one.mirrored)) for one in sights]
        self.folder.mkdir(parents=True, exist_ok=True)
        save_arrays(
            self.folder / f"{before:09}.npz",
            {
                "made_of": np.array(self.key),
                "sights": np.array([(one.frame, one.track) for one in sights]).reshape(-1, 2),
                "poses": np.array(rows).reshape(len(rows), 2, -1),
                "tracks": state.tracks,
                "counters": np.array([state.frame, state.shot, state.next_id, state.next_search]),
            },
        )

    def load(self) -> tuple[list[Sight], TrackerState | None]:
        """Load detections and tracker state of all parts; nothing if one is of another film."""
        sights, state = list[Sight](), None
        for path in sorted(self.folder.glob("*.npz")):
            arrays = load_arrays(path)
            if str(arrays.get("made_of")) != self.key or int(path.stem) != len(sights):
                self.remove()
                return [], None
            sights += [
                Sight(int(frame), int(track), _pose_of_numbers(pose), _pose_of_numbers(mirrored))
                for (frame, track), (pose, mirrored) in zip(
                    arrays["sights"], arrays["poses"], strict=True
                )
            ]
            frame, shot, next_id, next_search = arrays["counters"].tolist()
            state = TrackerState(frame, shot, next_id, next_search, arrays["tracks"])
        return sights, state

    def remove(self) -> None:
        """Delete all parts."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _numbers_of_pose(pose: Pose) -> Float[np.ndarray, " numbers"]:
    parts = (
        pose.pixels, pose.visibility, pose.presence, pose.inside, pose.score, pose.region.centre,
        pose.region.side, pose.region.angle, pose.next_points,
    )  # fmt: skip
    return np.concatenate([np.ravel(one) for one in parts]).astype(float)


def _pose_of_numbers(numbers: Float[np.ndarray, " numbers"]) -> Pose:
    pixels, visibility, presence, inside, score, centre, side, angle, after = np.split(
        numbers, np.cumsum(_SIZES)[:-1]
    )
    return Pose(
        pixels=pixels.reshape(-1, 2),
        visibility=visibility,
        presence=presence,
        inside=inside > 0,
        score=float(score[0]),
        region=Region(centre, float(side[0]), float(angle[0])),
        next_points=after.reshape(2, 2),
    )
