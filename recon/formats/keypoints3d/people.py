"""Several people in the frames of one file without names: who is who, and whom to take."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError

Person = Float[np.ndarray, "points numbers"]
"""Landmarks of somebody in one frame, in any unit; NaN where not seen."""
_APART = 0.35
"""Mean distance, in heights of the body, from which on a pose goes on in nobody's."""


def followed(frames: Sequence[Sequence[Person]]) -> list[dict[int, int]]:
    """Everybody's place in the lists of the frames, by the frame, from the first seen on.

    A person goes on in that pose of the next frame which is nearest, all people together. Poses
    that are given about the hips say nothing of where somebody is; with what they are seen at in
    the image beside them, people who move alike are told apart, too.
    """
    from scipy.optimize import linear_sum_assignment

    people: list[dict[int, int]] = []
    last: list[Person] = []
    for number, poses in enumerate(frames):
        cost = np.array([[_distance(one, other) for other in poses] for one in last])
        cost = cost.reshape(len(last), len(poses))
        new = set(range(len(poses)))
        for k, place in zip(*linear_sum_assignment(cost), strict=True):
            if cost[k, place] < _APART:
                people[k][number], last[k] = int(place), poses[place]
                new.discard(int(place))
        for place in sorted(new):
            people.append({number: place})
            last.append(poses[place])
    return people


def taken(
    counts: Sequence[int], frames: int, person: int | None, name: str
) -> tuple[int, tuple[str, ...]]:
    """Whom to take of several people, and what is said about it.

    Args:
        counts: frames in which each of them is seen.
        frames: of the file.
        person: whom the caller asks for; None takes who is seen longest.
        name: of the file, for messages.

    Raises:
        ValueError: when there is nobody of that number.
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


def _distance(a: Person, b: Person) -> float:
    """Mean distance of the landmarks that both have, in heights of the larger body."""
    both = np.isfinite(a).all(-1) & np.isfinite(b).all(-1)
    if not both.any():
        return np.inf
    tall = max(float(np.ptp(one[both, :3], axis=0).max()) for one in (a, b))
    return float(np.linalg.norm(a[both] - b[both], axis=-1).mean()) / max(tall, 1e-9)
