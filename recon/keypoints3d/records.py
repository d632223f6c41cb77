"""Records of 3D keypoints in a file's own unit, axes and names."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import FRAME_RATE, FRAMES, JOINTS
from recon.core.units import snapped_rate
from recon.formats.scan_times import frames_of_even_times, ticks_per_second
from recon.formats.text_tables import with_missing_frames

_LARGEST = 1e7
"""Coordinate of a point ten kilometres away, in millimetres."""


@dataclass(frozen=True)
class Points3D:
    """Points in space over time, as a file has them: its own names, unit and axes."""

    name: str
    positions: Float[np.ndarray, "time points 3"]
    """Coordinates in the file's own unit and axes; NaN where a point was not seen."""
    names: tuple[str, ...] = ()
    """Labels of the file; none where an array has none."""
    layout: str | None = None
    """Layout of the keypoints, where the format states it."""
    fps: float | None = None
    """Frames per second; None where the file does not state it."""
    start_time: float = 0.0
    """Time of the first frame, seconds."""
    unit: str | None = None
    """Unit that the file or its format states, one of `recon.core.units.METRES`."""
    decisions: tuple[str, ...] = ()
    """What was read or guessed, one sentence each."""

    def with_stated_rate(self, fps: float | None) -> "Points3D":
        """The points with the frame rate that the file states, if any."""
        if fps is None:
            return self
        note = f"{fps:g} frames per second: stated by the file"
        return replace(self, fps=fps, decisions=(*self.decisions, note))

    def with_rate_of_times(
        self, times: np.ndarray | None, source: str | None = None
    ) -> "Points3D":
        """The points with the frame rate that follows from a column of times, if there is one.

        A single time, or times that do not rise evenly, determine no rate. Frames that were
        dropped between times of whole frames become unseen. Times are taken as milli-, micro- or
        nanoseconds if that makes a usual rate and seconds do not.

        Args:
            times: one for every frame; None where there are none.
            source: the file that has them, for the decision; None for that of the points.

        Raises:
            ValueError: when a time is earlier than the one before.
        """
        steps = np.diff([] if times is None else times)
        if times is None or len(steps) == 0:
            return self
        place = source or self.name
        if (back := steps < 0).any():
            raise FormatError(
                f"{place}: expected times that rise, got {times[1:][back][0]:g} s after "
                f"{times[:-1][back][0]:g} s"
            )
        middle, span = float(np.median(steps)), float(times[-1] - times[0])
        even = np.abs(steps - middle).max() <= middle / 2
        clock = None if even or len(times) != len(self.positions) else frames_of_even_times(times)
        count = len(steps) if clock is None else int(clock[-1])
        rate = count / span if span > 0 else 0.0
        unit = ticks_per_second(snapped_rate(rate))
        fps = snapped_rate(rate * unit)
        if not FRAME_RATE.holds(fps) or not (even or clock is not None):
            said = f"the times in {place} do not rise evenly by a usual step and were not used"
            return replace(self, decisions=(*self.decisions, said))
        said = f"{fps:g} frames per second: by the times in {place}"
        said += f", {unit:g} a second" if unit > 1 else ""
        points = replace(self, fps=fps, start_time=float(times[0]) / unit)
        if clock is not None:
            points = replace(
                points, positions=with_missing_frames(self.positions, clock, place)[0]
            )
            said += f", between which {count - len(steps)} frames are missing: taken as unseen"
        return replace(points, decisions=(*self.decisions, said))

    def checked(self) -> "Points3D":
        """The points with NaN for missing ones; an error if none is seen at all.

        Infinity and exact zeros in all three coordinates mean a missing point, too, unless the
        same point is zero in all frames, as the origin of relative coordinates is. A repeated
        number that fills all three coordinates (-9999) also means a missing point.

        Raises:
            ValueError: when there are too many, or none at all is seen.
        """
        frames, count = self.positions.shape[:2]
        JOINTS.check(count, self.name)
        if frames == 0 or count == 0:
            raise FormatError(f"{self.name}: expected at least one frame with keypoints, got none")
        FRAMES.check(frames, self.name)
        seen = np.isfinite(self.positions).all(-1)
        zero = (self.positions == 0).all(-1)
        seen &= ~zero | zero.all(0)
        same = seen & ~zero & (self.positions == self.positions[..., :1]).all(-1)
        found, counts = np.unique(self.positions[same][:, 0], return_counts=True)
        codes, said = found[counts > 1], self.decisions
        if len(codes) > 0:
            coded = same & np.isin(self.positions[..., 0], codes)
            seen &= ~coded
            said += (f"{coded.sum()} points with {codes[0]:g} as all coordinates are not seen",)
        if not seen.any() or zero.all():
            raise FormatError(f"{self.name}: expected keypoints, but none is seen in any frame")
        largest = float(np.abs(self.positions[seen]).max())
        if largest > _LARGEST:
            raise FormatError(
                f"{self.name}: expected coordinates of a person, of at most {_LARGEST:g} in any "
                f"unit, got {largest:.3g}"
            )
        positions = np.where(seen[..., None], self.positions, np.nan)
        return replace(self, positions=positions, decisions=said)


Person = Float[np.ndarray, "points numbers"]
"""Landmarks of somebody in one frame, in any unit; NaN where not seen."""
APART = 0.35
"""Mean distance, in heights of the body, from which on a pose goes on in nobody's."""


def tracks_of_people(frames: Sequence[Sequence[Person]]) -> list[dict[int, int]]:
    """Return, for every person, a mapping from frame to the person's index in that frame's list.

    People are matched from frame to frame so that the sum of the distances of their poses is
    least. Poses relative to the hips do not say where a person is. If positions in the image are
    given too, people who move alike are distinguished as well.
    """
    from scipy.optimize import linear_sum_assignment

    people: list[dict[int, int]] = []
    last: list[Person] = []
    for number, poses in enumerate(frames):
        cost = np.array([[body_distance(one, other) for other in poses] for one in last])
        cost = cost.reshape(len(last), len(poses))
        new = set(range(len(poses)))
        for k, place in zip(*linear_sum_assignment(cost), strict=True):
            if cost[k, place] < APART:
                people[k][number], last[k] = int(place), poses[place]
                new.discard(int(place))
        for place in sorted(new):
            people.append({number: place})
            last.append(poses[place])
    return people


def chosen_person(
    counts: Sequence[int], frames: int, person: int | None, name: str
) -> tuple[int, tuple[str, ...]]:
    """Return the index of the person to read, and a note about the choice if there are several.

    Args:
        counts: frames in which each of them is seen.
        frames: of the file.
        person: whom the caller asks for; None takes who is seen longest.
        name: of the file, for messages.

    Raises:
        ValueError: when there is no person of that index.
    """
    listed = ", ".join(f"person {k} in {count}" for k, count in enumerate(counts))
    if person is not None and not 0 <= person < len(counts):
        raise FormatError(f"{name}: there is no person {person}; of {frames} frames, {listed}")
    if len(counts) == 1:
        return 0, ()
    chosen = int(np.argmax(counts)) if person is None else person
    how = "seen longest" if person is None else "asked for"
    return chosen, (
        f"{len(counts)} people; of {frames} frames, {listed}: person {chosen} was taken, {how} "
        "(--person takes another)",
    )


def body_distance(a: Person, b: Person) -> float:
    """Mean distance of the landmarks that both people show, in heights of the larger one."""
    both = np.isfinite(a).all(-1) & np.isfinite(b).all(-1)
    if not both.any():
        return np.inf
    tall = max(float(np.ptp(one[both, :3], axis=0).max()) for one in (a, b))
    return float(np.linalg.norm(a[both] - b[both], axis=-1).mean()) / max(tall, 1e-9)
