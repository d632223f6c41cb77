"""Records of recorded joints or markers, in metres with z up."""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from recon.core import coordinates as told
from recon.core import limits, units
from recon.core.bone_names import side_and_words_of
from recon.core.errors import FormatError, UnitsError
from recon.core.units import Up

LEAD_IN_SPEED = 10.0
"""Metres per second, mean over joints: no body moves so, a jump out of a T-pose does."""
LEAD_IN_FRAMES = 8
"""Frames at the start that may belong to it."""


@dataclass(frozen=True)
class SkeletonRecording:
    """A recorded skeleton from any program; parents come before their children.

    positions[child] = positions[parent] + orientations[parent] @ rest_offsets[child], except
    where the recording itself moves a joint within its parent. Tips of the last bones (BVH end
    sites) are joints too, called `<joint>_end`.
    """

    name: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of every joint's parent, -1 for the root."""
    rest_offsets: Float[np.ndarray, "joints 3"]
    """Metres, in the frame of the parent; the file's own axes, not turned to z up."""
    positions: Float[np.ndarray, "time joints 3"]
    """World frame, metres, z up."""
    orientations: Float[np.ndarray, "time joints 3 3"]
    """Rotation of every joint's own frame to the world."""
    fps: float
    decisions: tuple[str, ...]
    """What was read or guessed about unit, axis and rate, one sentence each."""
    start_time: float = 0.0
    """Time of the first frame, seconds; frames that were cut off before it count."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.positions)

    def window(self, start: int, stop: int) -> "SkeletonRecording":
        """Return the recording of the frames from `start` to `stop` - 1, at unchanged times."""
        return dataclasses.replace(
            self,
            positions=self.positions[start:stop],
            orientations=self.orientations[start:stop],
            start_time=self.start_time + start / self.fps,
        )

    def joint(self, name: str) -> int:
        """Return the index of the joint of a given name.

        Raises:
            ValueError: when there is no such joint; the message lists all names.
        """
        if name not in self.joint_names:
            known = ", ".join(self.joint_names)
            raise FormatError(f"{self.name}: no joint is called {name!r}; there are {known}")
        return self.joint_names.index(name)

    def descendants(self, joint: int) -> list[int]:
        """Return the indices of a joint and of all joints below it in the tree."""
        chain = {joint}
        for child, parent in enumerate(self.parents):
            if parent in chain:
                chain.add(child)
        return sorted(chain)

    @property
    def body_root(self) -> int:
        """Index of the body's root: the first joint with more than one child, else 0."""
        children = np.bincount([parent for parent in self.parents if parent >= 0])
        branching = np.flatnonzero(children > 1)
        return int(branching[0]) if len(branching) > 0 else 0


@dataclass(frozen=True)
class MarkerRecording:
    """Labelled points on a body, some of them hidden in some frames."""

    name: str
    marker_names: tuple[str, ...]
    positions: Float[np.ndarray, "time markers 3"]
    """World frame, metres, z up; zero where not visible."""
    visible: Bool[np.ndarray, "time markers"]
    fps: float
    decisions: tuple[str, ...]
    """What was read or guessed about unit, axis and rate, one sentence each."""
    start_time: float = 0.0
    """Time of the first frame, seconds of the recording's own clock: that of a C3D file begins
    with frame 1, that of a TRC file is its column Time."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.positions)

    def window(self, start: int, stop: int) -> "MarkerRecording":
        """Return the recording of the frames from `start` to `stop` - 1, at unchanged times."""
        return dataclasses.replace(
            self,
            positions=self.positions[start:stop],
            visible=self.visible[start:stop],
            start_time=self.start_time + start / self.fps,
        )

    def evenly_spread(self, count: int) -> "MarkerRecording":
        """Return at most `count` evenly spaced frames; `fps` and times are not valid then."""
        index = np.unique(np.linspace(0, self.frames - 1, count).round().astype(int))
        return dataclasses.replace(
            self, positions=self.positions[index], visible=self.visible[index]
        )

    def select(self, names: Sequence[str]) -> "MarkerRecording":
        """Return the recording with only the named markers, in the given order.

        Raises:
            ValueError: naming the markers that the recording lacks.
        """
        if missing := [name for name in names if name not in self.marker_names]:
            known = ", ".join(self.marker_names)
            raise FormatError(f"{self.name}: no markers {', '.join(missing)}; there are {known}")
        chosen = [self.marker_names.index(name) for name in names]
        return dataclasses.replace(
            self,
            marker_names=tuple(names),
            positions=self.positions[:, chosen],
            visible=self.visible[:, chosen],
        )


def skeleton_in_metres(
    raw: SkeletonRecording,
    *,
    unit: str | None,
    up: Up | None,
    declared: str | None = None,
) -> SkeletonRecording:
    """Convert a skeleton to metres and z up, with notes on how unit and axes were decided.

    Args:
        raw: as in the file; by custom of its format y points up.
        unit: given by the user, in place of the file's; the body must then be of human size.
        up: axis that points up or down, given by the user; None finds it from the body.
        declared: unit that the file states.

    Raises:
        ValueError: when unit or axis cannot be told, or numbers are not finite.
    """
    if raw.frames == 0:
        raise FormatError(f"{raw.name}: expected at least one frame, got none")
    limits.FRAME_RATE.check(raw.fps, raw.name)
    arrays = (raw.positions, raw.orientations, raw.rest_offsets)
    if not all(np.isfinite(array).all() for array in arrays):
        raise FormatError(f"{raw.name}: expected finite numbers, got NaN or infinity")
    length = head_to_foot_length(raw.joint_names, raw.parents, raw.rest_offsets)
    unit, reason = _decided_unit(unit, declared, length, told.unit_from_bones, raw.name)
    visible = np.ones(raw.positions.shape[:2], dtype=bool)
    up_reason = f"up axis {up}: given"
    if up is None:
        up, up_reason = told.inferred_up(raw.joint_names, raw.positions, visible, "y", raw.name)
    turn, metres = units.to_z_up(up), units.METRES[unit]
    limits.POSITION.check(raw.rest_offsets * metres, raw.name, "offsets of the joints")
    limits.POSITION.check(raw.positions * metres, raw.name, "[frame, joint, axis]")
    return dataclasses.replace(
        raw,
        rest_offsets=raw.rest_offsets * metres,
        positions=raw.positions @ (turn.T * metres),
        orientations=turn @ raw.orientations,
        decisions=(*raw.decisions, reason, up_reason),
    )


def markers_in_metres(
    raw: MarkerRecording,
    *,
    unit: str | None,
    up: Up | None,
    declared: str | None = None,
    usual_up: Up | None = None,
) -> MarkerRecording:
    """Convert markers to metres and z up, as `skeleton_in_metres` does.

    A marker that is not finite, or lies exactly at the origin, is not visible. Labels that repeat
    are numbered (RKNE, RKNE#2), those of the copy seen most first, as copies may be of two people.

    Args:
        raw: as in the file.
        unit: as in `skeleton_in_metres`.
        up: as in `skeleton_in_metres`.
        declared: as in `skeleton_in_metres`.
        usual_up: axis that the file hints at, or the custom of its format.

    Raises:
        ValueError: when unit or axis cannot be told, or no marker is visible.
    """
    visible = raw.visible & np.isfinite(raw.positions).all(-1) & (raw.positions != 0).any(-1)
    if not visible.any():
        raise FormatError(f"{raw.name}: expected markers, but none is visible in any frame")
    limits.FRAME_RATE.check(raw.fps, raw.name)
    positions = np.where(visible[..., None], raw.positions, 0.0)
    shown = visible.any(1)
    ends = [np.where(visible[..., None], positions, far)[shown] for far in (math.inf, -math.inf)]
    extent = np.median(ends[1].max(1) - ends[0].min(1), axis=0)
    often = visible[shown].mean(0) > _MOSTLY_SEEN
    names = [name for name, one in zip(raw.marker_names, often, strict=True) if one]
    unit, reason = _decided_unit(
        unit, declared, float(extent.max()), told.unit_from_markers, raw.name, names
    )
    up_reason = f"up axis {up}: given"
    if up is None:
        up, up_reason = told.inferred_up(
            raw.marker_names, positions, visible, usual_up, raw.name, extent
        )
    turned = positions @ (units.to_z_up(up).T * units.METRES[unit])
    limits.POSITION.check(turned, raw.name, "[frame, marker, axis]")
    names, said = _numbered(raw.marker_names, visible.sum(0).tolist())
    return dataclasses.replace(
        raw,
        marker_names=tuple(names),
        positions=turned,
        visible=visible,
        decisions=(*raw.decisions, reason, up_reason, *said),
    )


def _numbered(labels: Sequence[str], shown: Sequence[int]) -> tuple[list[str], tuple[str, ...]]:
    """Number labels that repeat, those of the copy seen in most frames first; note if any do."""
    times = Counter(labels)
    copies = [labels[:k].count(label) for k, label in enumerate(labels)]
    total = Counter[int]()
    for label, copy, frames in zip(labels, copies, shown, strict=True):
        total[copy] += frames * (times[label] > 1)
    names, given = list(labels), Counter[str]()
    for k in sorted(range(len(labels)), key=lambda k: -total[copies[k]]):
        given[labels[k]] += 1
        names[k] += f"#{given[labels[k]]}" if given[labels[k]] > 1 else ""
    again = [label for label, count in times.items() if count > 1]
    if not again:
        return names, ()
    return names, (
        f"labels that repeat: {len(again)} ({again[0]}, ...); those of copy "
        f"{max(total, key=lambda copy: total[copy]) + 1}, seen most, keep the name, others are "
        f"numbered ({again[0]}#2)",
    )


_MOSTLY_SEEN = 0.75
"""Share of frames in which markers are seen that must give a body its size."""
_GIVEN_SIZE_M = (0.3, 10)
"""Metres outside of which nobody, and no group of people, was recorded."""


def _decided_unit(
    given: str | None,
    declared: str | None,
    size: float,
    guess: Callable[[float, str], tuple[str, str]],
    name: str,
    names: Sequence[str] = (),
) -> tuple[str, str]:
    """Return the unit that the user gives, the file states or the size implies, and why.

    Raises:
        UnitsError: when the unit gives a size that no human body has.
    """
    units.check_unit(given)
    if given is not None:
        (low, high), metres = _GIVEN_SIZE_M, size * units.METRES[given]
        if not low <= metres <= high:
            raise UnitsError(
                f"{name}: expected a body of {low} m to {high} m, but with --unit {given} it "
                f"measures {metres:.3g} m; leave --unit out, or give the unit of its coordinates"
            )
        return given, f"unit {given}: given"
    if declared is not None:
        return declared, told.reason_for_declared_unit(declared, size, name, names)
    return guess(size, name)


def stated_rate(rate: float, source: object, place: str) -> tuple[float, str]:
    """Check a frame rate that a file states; return it with a note on its source.

    Raises:
        ValueError: when nothing is recorded at such a rate.
    """
    limits.FRAME_RATE.check(rate, source, place)
    fps = units.snapped_rate(rate)
    return fps, f"{fps:g} frames per second: stated by the file"


def posed_skeleton(
    parents: Sequence[int],
    local: Iterable[tuple[np.ndarray, np.ndarray]],
    frames: int,
) -> tuple[Float[np.ndarray, "time joints 3"], Float[np.ndarray, "time joints 3 3"]]:
    """Compute world positions and orientations of joints by forward kinematics.

    Args:
        parents: of the joints, which come before their children; -1 for the root.
        local: place (3) or (time, 3) of every joint in its parent's frame, and its rotation
            (3, 3) or (time, 3, 3) there; those of the root are in the world.
        frames: how many there are.
    """
    positions = np.empty((frames, len(parents), 3))
    orientations = np.empty((frames, len(parents), 3, 3))
    for joint, (parent, (shift, turn)) in enumerate(zip(parents, local, strict=True)):
        if parent < 0:
            positions[:, joint], orientations[:, joint] = shift, turn
        else:
            above = orientations[:, parent]
            positions[:, joint] = positions[:, parent] + (above @ shift[..., None])[..., 0]
            orientations[:, joint] = above @ turn
    return positions, orientations


def finite_numbers(words: Sequence[str], count: int, place: str) -> list[float]:
    """Parse `count` finite numbers.

    Raises:
        ValueError: when there are more or fewer, or a word is not a number.
    """
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise FormatError(f"{place}: expected numbers, got {' '.join(words)[:60]!r}") from error
    if len(values) != count or not np.isfinite(values).all():
        raise FormatError(f"{place}: expected {count} numbers, got {' '.join(words)[:60]!r}")
    return values


def drop_lead_in(recording: SkeletonRecording) -> SkeletonRecording:
    """Cut off frames at the start, such as a T-pose, after which the joints jump away.

    Most such files have one frame of it; some converters blend it into the next few.
    """
    first = recording.positions[: LEAD_IN_FRAMES + 1]
    moved = np.diff(first, axis=0)
    speeds = np.linalg.norm(moved, axis=-1).mean(-1) * recording.fps
    jumps = np.flatnonzero(speeds > LEAD_IN_SPEED)
    if len(jumps) == 0:
        return recording
    count = int(jumps[-1]) + 1
    reason = (
        f"{count} frame(s) cut from the start: a T-pose, after which joints jump at "
        f"{speeds.max():.0f} m/s"
    )
    kept = recording.window(count, recording.frames)
    return dataclasses.replace(kept, decisions=(*recording.decisions, reason))


def head_to_foot_length(
    names: Sequence[str], parents: Sequence[int], offsets: Float[np.ndarray, "joints 3"]
) -> float:
    """Longest path along the bones from a head joint to a foot joint, in the offsets' unit.

    It does not depend on the pose. Where no name says head, it begins at any joint of the trunk,
    whose name and whose parents' names have no side. Where no names tell limbs or feet either, it
    is the longest path between any two joints, from foot to fingertip, which is 1.4 times as long.
    """
    words = [name.lower().split(":")[-1] for name in names]
    heads = [j for j, word in enumerate(words) if "head" in word]
    feet = [j for j, word in enumerate(words) if any(w in word for w in ("foot", "toe", "ankle"))]
    every = range(len(names))
    trunk: set[int] = set()
    for j, (name, parent) in enumerate(zip(names, parents, strict=True)):
        if (parent < 0 or parent in trunk) and not side_and_words_of(name)[0]:
            trunk.add(j)
    depth = np.zeros(len(names))
    # an infinite length is refused later, since no unit fits it
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(offsets, axis=-1)
    for joint, (parent, length) in enumerate(zip(parents, lengths, strict=True)):
        depth[joint] = 0.0 if parent < 0 else depth[parent] + length
    # root distance of the farthest head (row 0) and foot (row 1) among a joint's descendants
    deepest = np.full((2, len(names)), -math.inf)
    for kind, ends in enumerate((heads or trunk or every, feet or every)):
        deepest[kind, list(ends)] = depth[list(ends)]
    longest = 0.0
    for joint in reversed(every):
        parent = parents[joint]
        if parent >= 0:
            head, foot = deepest[:, joint] + deepest[::-1, parent]
            longest = max(longest, float(max(head, foot) - 2 * depth[parent]))
            deepest[:, parent] = np.maximum(deepest[:, parent], deepest[:, joint])
    return longest
