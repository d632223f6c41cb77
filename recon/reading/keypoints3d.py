"""3D keypoints of a file at the door: which they are, unit, up, ground, place in the world.

Everything that is guessed is said, and what cannot be right is refused with what would fit.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from observations.correspondences import BodyPoints
from recon.body.model import BodyModel
from recon.core.errors import FormatError, UnitsError
from recon.core.skeleton import JOINT, keypoint_names
from recon.core.units import METRES, Up, check_override, to_z_up
from recon.core.upright import decide_any_up
from recon.formats.keypoints3d.labels import meant_keypoints
from recon.formats.keypoints3d.reader import with_rate
from recon.formats.keypoints3d.records import Points3D
from recon.formats.observations import PositionsFile
from recon.reading.points import GOOD, bone_lengths, settle_body_layout

_SMALLEST, _LARGEST = 0.5, 1.4
"""Sizes against the average body between which a unit is right."""
_FEWEST = 8
"""Keypoints that must be known by name."""
_ROOT = 0.04
"""Metres from the origin within which the middle of the hips of root-relative data stays."""
_FLOOR = (-0.05, 0.08)
"""Metres at which the lowest points of feet lie on a ground at z = 0: soles, and noise."""
_STRAIGHT = 0.06
"""Tangent of the angle up to which shoulders are straight above ankles. A camera that is tilted by
so little does less harm than a search for its tilt in data that tell no path."""
_ABOVE = 0.1
"""Height of a neck above the middle of the shoulders, in their width, from which on it is the
upper end of the neck; that of the average body is 0.19."""
_ANKLE = 0.07
"""Metres that ankles stand above the sole."""
_HIGH = ("head_top", f"head{JOINT}", "nose", "left_ear", "right_ear", "left_eye", "right_eye")
_SHOULDERS = ("left_shoulder", "right_shoulder", "neck", f"neck{JOINT}")
_LOW = ("left_ankle", "right_ankle", "left_heel", "right_heel", "left_big_toe", "right_big_toe")


@dataclass(frozen=True)
class _Known:
    """Points whose names are known."""

    names: tuple[str, ...]
    positions: Float[np.ndarray, "time points 3"]
    """NaN where not seen."""
    decisions: tuple[str, ...]


def settled(
    raw: Points3D,
    body: BodyModel,
    *,
    fps: float | None = None,
    unit: str | None = None,
    up: Up | None = None,
    layout: str | None = None,
) -> PositionsFile:
    """3D keypoints in metres with z up.

    Args:
        raw: as the file has them.
        body: whose proportions tell layout and unit.
        fps: frames per second; None where the file states it.
        unit: of the positions; None to read it from the file, or to tell it from the size.
        up: axis that points up, or down; None to tell it from head and feet.
        layout: which keypoints an array without names holds; None to tell it.

    Raises:
        ValueError: when something cannot be told or cannot be right; the message says what was
            found and which option decides.
    """
    check_override(unit)
    raw = with_rate(raw, fps)
    known = _neck(_named(raw, body, layout))
    metres, unit_said = _unit(known, body, raw, unit)
    up, up_said = _up(known, raw.name, up)
    positions = known.positions @ (to_z_up(up).T * metres)
    visible = np.all(np.isfinite(positions), axis=-1)
    positions = np.where(visible[..., None], positions, 0.0)
    placed = not _about_the_pelvis(known.names, positions, visible)
    level = not up.endswith("down")
    said = [*raw.decisions, *known.decisions, unit_said, up_said]
    if not level and not placed and _upright(known.names, positions, visible):
        level = True
        said.append("shoulders are straight above the ankles: the camera is taken to be level")
    elif not level:
        said.append("the frame is a camera's, which may be tilted: gravity is estimated")
    if placed:
        ground_known, ground_said = _ground(known.names, positions, visible, level=level)
        said.append(ground_said)
    else:
        ground_known = level
        said.append(
            "relative to the pelvis: the data have no place in the world; path and height are "
            "inferred from the feet, which stand"
        )
    return PositionsFile(
        kind="keypoints3d",
        positions=positions,
        visible=visible,
        names=known.names,
        fps=float(raw.fps or 0.0),
        start_time=raw.start_time,
        ground_known=ground_known,
        level=level,
        placed=placed,
        decisions=tuple(said),
    )


def _named(raw: Points3D, body: BodyModel, layout: str | None) -> _Known:
    """The points with names of our table; others are left out and named."""
    if raw.names is None:
        chosen, reason = settle_body_layout(raw.positions, layout or raw.layout, body, raw.name)
        names = keypoint_names(chosen)
        if chosen == "smpl22":
            names = tuple(str(name) for name in meant_keypoints(names))
        return _Known(names, raw.positions, () if reason in raw.decisions else (reason,))
    meant = meant_keypoints(raw.names)
    kept = [k for k, name in enumerate(meant) if name is not None and name not in meant[:k]]
    unknown = [raw.names[k] for k in range(len(meant)) if k not in kept]
    names = tuple(str(meant[k]) for k in kept)
    if len(names) < _FEWEST:
        raise FormatError(
            f"{raw.name}: {len(names)} of its points are keypoints of a body by name "
            f"({', '.join(names) or 'none'}), which is too few; found {_some(raw.names)}, "
            "expected names such as left_hip, LKnee, RAnkle, nose"
        )
    said = [f"{len(names)} keypoints by name"]
    if unknown:
        said.append(f"points that are no keypoints of the body, left out: {_some(unknown)}")
    return _Known(names, raw.positions[:, kept], tuple(said))


def _neck(known: _Known) -> _Known:
    """The points, with a neck that lies above the shoulders as what it is.

    Detectors call the middle of the shoulders a neck (OpenPose, HALPE), or its upper end
    (BODY_25B).
    """
    needed = ("neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
    if not set(needed) <= set(known.names) or "upper_neck" in known.names:
        return known
    neck, *shoulders, left, right = (known.positions[:, known.names.index(n)] for n in needed)
    middle = (shoulders[0] + shoulders[1]) / 2
    up = middle - (left + right) / 2
    width = np.linalg.norm(shoulders[0] - shoulders[1], axis=-1)
    height = ((neck - middle) * up).sum(-1) / np.linalg.norm(up, axis=-1) / width
    height = height[np.isfinite(height)]
    if len(height) == 0 or float(np.median(height)) < _ABOVE:
        return known
    names = tuple("upper_neck" if name == "neck" else name for name in known.names)
    said = "the neck is its upper end, as it lies above the shoulders"
    return _Known(names, known.positions, (*known.decisions, said))


def _some(names: tuple[str, ...] | list[str]) -> str:
    more = "" if len(names) <= 8 else f" and {len(names) - 8} more"
    return ", ".join(names[:8]) + more


def _unit(known: _Known, body: BodyModel, raw: Points3D, given: str | None) -> tuple[float, str]:
    """Metres per unit, and the reason."""
    points = BodyPoints.of_names(known.names, body)
    found = bone_lengths(known.positions, points, body)
    if found is None:
        unit = given or raw.unit
        if unit is None:
            raise UnitsError(
                f"{raw.name}: too few bones are seen to tell the unit; give it with --unit"
            )
        return METRES[unit], f"unit {unit}: {'given' if given else 'stated by the file'}"
    if raw.names is not None and found.misfit > 2 * GOOD:
        raise FormatError(
            f"{raw.name}: the points are no body by their names: bones change their lengths or "
            "have lengths that no person's have; check the names of the points"
        )
    fitting = [one for one in ("m", "cm", "mm") if _SMALLEST < found.size * METRES[one] < _LARGEST]
    unit, why = given or raw.unit, "given" if given else "stated by the file"
    if unit is not None:
        size = found.size * METRES[unit]
        if _SMALLEST < size < _LARGEST:
            return METRES[unit], f"unit {unit}: {why}, the body is {size:.2f} times average"
        hint = f"; give --unit {fitting[0]}" if fitting else ""
        raise UnitsError(
            f"{raw.name}: the unit is {unit} ({why}), but then the body is {size:.3g} times as "
            f"large as an average person{hint}"
        )
    if not fitting:
        raise UnitsError(
            f"{raw.name}: the points are {found.size:.3g} times as far from each other as those "
            "of an average person in metres, which no person is in m, cm or mm; scale them to "
            "metres, or give --unit"
        )
    size = found.size * METRES[fitting[0]]
    return METRES[fitting[0]], f"unit {fitting[0]}: the body is {size:.2f} times average then"


def _up(known: _Known, name: str, given: Up | None) -> tuple[Up, str]:
    rise = _rise(known)
    if given is None:
        if rise is None:
            raise UnitsError(
                f"{name}: no frame shows head and feet, so nothing tells which axis points up; "
                "give it with --up"
            )
        return decide_any_up(rise, name)
    if rise is None:
        return given, f"up axis {given}: given"
    try:
        found, reason = decide_any_up(rise, name)
    except UnitsError:
        return given, f"up axis {given}: given"
    if found != given:
        return given, (
            f"up axis {given}: given, so that the person lies; {reason.partition(': ')[2]} "
            f"along {found}: if they stand, leave --up out or give --up {found}"
        )
    return given, f"up axis {given}: given"


def _rise(known: _Known) -> Float[np.ndarray, "3"] | None:
    """Mean vector from feet to head, or to the shoulders."""
    for high in (_HIGH, _SHOULDERS):
        top, bottom = _mean(known, high), _mean(known, _LOW)
        both = np.isfinite(top).all(-1) & np.isfinite(bottom).all(-1)
        if both.any():
            return (top - bottom)[both].mean(0)
    return None


def _mean(known: _Known, names: tuple[str, ...]) -> Float[np.ndarray, "time 3"]:
    rows = [k for k, name in enumerate(known.names) if name in names]
    some = known.positions[:, rows]
    count = np.isfinite(some).all(-1).sum(1)[:, None]
    total = np.where(np.isfinite(some), some, 0.0).sum(1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _about_the_pelvis(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
) -> bool:
    """Whether the middle of the hips, or the pelvis, is at the origin all the time."""
    for root in (("left_hip", "right_hip"), ("mid_hip",), (f"pelvis{JOINT}",)):
        rows = [names.index(name) for name in root if name in names]
        if len(rows) < len(root):
            continue
        seen = visible[:, rows].all(1)
        if not seen.any():
            continue
        away = np.linalg.norm(positions[seen][:, rows].mean(1), axis=-1)
        if float(np.quantile(away, 0.95)) < _ROOT:
            return True
    return False


def _upright(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
) -> bool:
    """Whether the shoulders are, on the average, straight above the ankles."""
    known = _Known(names, np.where(visible[..., None], positions, np.nan), ())
    rise = _mean(known, _SHOULDERS) - _mean(known, ("left_ankle", "right_ankle"))
    rise = rise[np.isfinite(rise).all(-1)]
    if len(rise) == 0:
        return False
    mean = rise.mean(0)
    return bool(np.linalg.norm(mean[:2]) < _STRAIGHT * mean[2])


def _ground(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    *,
    level: bool,
) -> tuple[bool, str]:
    """Whether feet stand on z = 0, and what is said about it."""
    if not level:
        return False, "ground: unknown, estimated from the way the person stands"
    soles = [k for k, name in enumerate(names) if name.endswith(("_heel", "_big_toe"))]
    lift = 0.0
    if not soles:
        soles = [k for k, name in enumerate(names) if name.endswith(("_ankle", f"foot{JOINT}"))]
        lift = _ANKLE
    heights = positions[:, soles, 2][visible[:, soles]] - lift
    if len(heights) == 0:
        return False, "ground: no feet are seen, so its height is estimated"
    lowest = float(np.quantile(heights, 0.1))
    if _FLOOR[0] <= lowest <= _FLOOR[1]:
        return True, "ground: z = 0, where the feet stand"
    return False, (
        f"ground: the feet stand at {lowest:.2f} m, so its height is estimated instead of z = 0"
    )
