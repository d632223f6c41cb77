"""Rotations as angles about axes: three axes in sequence without jumps, and joints of fewer."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

_LOCKED = 1e-6
"""Distance from gimbal lock, as the sine of an angle, below which only the sum or the difference
of the first and the last angle is known."""
_ROUNDS = 60
"""Rounds of fitting one axis after the other; axes of joints are far from parallel, so that every
round leaves less than a tenth of the error."""


def cardan(rotations: Float[np.ndarray, "time 3 3"], order: str) -> Float[np.ndarray, "time 3"]:
    """Angles (q1, q2, q3), radians, with R = R_a(q1) R_b(q2) R_c(q3) for three different axes.

    The middle angle begins within ±90°. From then on, of the two solutions that every rotation
    has, the one nearer to the frame before is taken, and whole turns are added, so that angles do
    not jump. Where the middle angle is ±90° the last one is held.

    Args:
        rotations: of the distal segment relative to the proximal one.
        order: three different letters of XYZ.
    """
    a, b, c = ("XYZ".index(letter) for letter in order)
    sign = 1.0 if (b - a) % 3 == 1 else -1.0
    r = rotations
    cosine = np.hypot(r[:, a, a], r[:, a, b])
    q1 = np.arctan2(-sign * r[:, b, c], r[:, c, c])
    q2 = np.arctan2(sign * r[:, a, c], cosine)
    q3 = np.arctan2(-sign * r[:, a, b], r[:, a, a])
    first = np.stack((q1, q2, q3), -1)
    second = np.stack((q1 + np.pi, np.pi - q2, q3 + np.pi), -1)
    # R = R_a(q1 ± q3) R_b(±90°)
    turned = np.arctan2(sign * r[:, c, b], r[:, b, b])
    return _continued(first, second, cosine, turned, np.sign(r[:, a, c]))


def elevation(rotations: Float[np.ndarray, "time 3 3"]) -> Float[np.ndarray, "time 3"]:
    """Angles (q1, e, q3), radians, with R = R_y(q1) R_x(-e) R_y(q3) and e from 0° to 180°.

    It is the sequence of the ISB for the shoulder: plane of elevation, elevation, axial rotation.
    Where the elevation is 0° or 180° the last angle is held.
    """
    r = rotations
    sine = np.hypot(r[:, 0, 1], r[:, 2, 1])
    q1 = np.arctan2(-r[:, 0, 1], -r[:, 2, 1])
    q3 = np.arctan2(-r[:, 1, 0], r[:, 1, 2])
    angles = np.stack((q1, np.arctan2(sine, r[:, 1, 1]), q3), -1)
    # R = R_y(q1 ± q3) R_x(0° or 180°)
    turned = np.arctan2(-r[:, 2, 0], r[:, 0, 0])
    return _continued(angles, angles, sine, turned, np.sign(r[:, 1, 1]))


def _continued(
    first: Float[np.ndarray, "time 3"],
    second: Float[np.ndarray, "time 3"],
    unlocked: Float[np.ndarray, " time"],
    turned: Float[np.ndarray, " time"],
    way: Float[np.ndarray, " time"],
) -> Float[np.ndarray, "time 3"]:
    """The solutions that follow each other without jumps, the first one at the beginning.

    Args:
        first: one solution of every frame.
        second: the other one.
        unlocked: distance from gimbal lock.
        turned: q1 + way q3, which is known in gimbal lock, too.
        way: 1 or -1.
    """
    if (unlocked < _LOCKED).any():
        return _continued_through_lock(first, second, unlocked, turned, way)
    both = np.stack((first, second))
    steps = both[None, :, 1:] - both[:, None, :-1]
    steps = np.abs(steps - 2 * np.pi * np.round(steps / (2 * np.pi))).sum(-1)
    branch = [0]
    # the solution that follows each of the two, frame by frame
    for follows in steps.argmin(1).T.tolist():
        branch.append(follows[branch[-1]])
    return np.unwrap(both[branch, np.arange(len(branch))], axis=0)


def _continued_through_lock(
    first: Float[np.ndarray, "time 3"],
    second: Float[np.ndarray, "time 3"],
    unlocked: Float[np.ndarray, " time"],
    turned: Float[np.ndarray, " time"],
    way: Float[np.ndarray, " time"],
) -> Float[np.ndarray, "time 3"]:
    """Solutions without jumps where some frames are in gimbal lock.

    The last angle of such a frame is that of the frame before, so that frames take their turns.
    """
    found = np.empty_like(first)
    before = np.zeros(3)
    for k in range(len(first)):
        if unlocked[k] < _LOCKED:
            held = before[2]
            choices = [np.array([turned[k] - way[k] * held, first[k, 1], held])]
        else:
            choices = [first[k]] if k == 0 else [first[k], second[k]]
        near = [one - 2 * np.pi * np.round((one - before) / (2 * np.pi)) for one in choices]
        # the first frame has none before it
        if k == 0:
            near = choices
        before = found[k] = min(near, key=lambda q: float(np.abs(q - before).sum()))
    return found


def about_axes(
    rotations: Float[np.ndarray, "time 3 3"], axes: Sequence[Sequence[float]]
) -> Float[np.ndarray, "time axes"]:
    """Angles, radians, of the turns about one or two axes in sequence that are nearest to R.

    Nearest in the Frobenius norm, as a joint of a model can follow a rotation that has parts it
    does not allow.

    Args:
        rotations: R of the distal segment relative to the proximal one.
        axes: one or two unit vectors, in the frame of the proximal segment in its zero pose.
    """
    units = [np.asarray(axis, dtype=float) / np.linalg.norm(axis) for axis in axes]
    turns: list[Callable[[np.ndarray], np.ndarray]] = [_turner(unit) for unit in units]
    angles = np.zeros((len(rotations), len(units)))
    if len(units) == 1:
        angles[:, 0] = _nearest_angle(rotations, units[0])
    else:
        for _ in range(_ROUNDS):
            rest = rotations @ np.swapaxes(turns[1](angles[:, 1]), -1, -2)
            angles[:, 0] = _nearest_angle(rest, units[0])
            rest = np.swapaxes(turns[0](angles[:, 0]), -1, -2) @ rotations
            angles[:, 1] = _nearest_angle(rest, units[1])
    return np.unwrap(angles, axis=0)


def _turner(unit: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    x, y, z = unit
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

    def turn(angle: np.ndarray) -> np.ndarray:
        sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
        return np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)

    return turn


def _nearest_angle(matrices: np.ndarray, unit: np.ndarray) -> Float[np.ndarray, " time"]:
    """The angle q at which trace(R(q)ᵀ M) is greatest."""
    m = matrices
    axial = np.stack(
        (m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]), 1
    )
    trace = np.trace(m, axis1=1, axis2=2)
    return np.arctan2(axial @ unit, trace - np.einsum("i,tij,j->t", unit, m, unit))
