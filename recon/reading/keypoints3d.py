"""Finds what a file of 3D keypoints does not state: names, unit, up axis, ground and origin.

Every guess is noted in the decisions. What cannot be right is refused, with what would fit.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from observations.correspondences import BodyPoints
from recon.body.model import BodyModel
from recon.core.coordinates import hint_at_adult, inferred_up
from recon.core.errors import FormatError, UnitsError
from recon.core.hands import right_handed_signs
from recon.core.layouts import JOINT, keypoint_names
from recon.core.units import METRES, Hand, Up, check_unit, to_z_up
from recon.formats.observations import PositionsFile
from recon.keypoints3d.labels import keypoints_of_labels, limbs_of_bones, split_off_hands
from recon.keypoints3d.reader import with_known_rate
from recon.keypoints3d.records import Points3D
from recon.reading.points import GOOD, bone_lengths, settle_body_layout

_SMALLEST, _LARGEST = 0.5, 1.4
"""Sizes against the average body between which a unit is right."""
_STATURE = 1.7
"""Metres that the average person is tall."""
_INSIDE = 0.7
"""Share of the points from which on they lie in an image: legs may lie below its lower edge."""
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
_SHOULDERS = ("left_shoulder", "right_shoulder", "neck", f"neck{JOINT}")


def points_in_metres(
    raw: Points3D,
    body: BodyModel,
    *,
    fps: float | None = None,
    unit: str | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
    layout: str | None = None,
) -> PositionsFile:
    """Convert 3D keypoints of a file to metres and axes with z up.

    Args:
        raw: keypoints as the file has them.
        body: body whose proportions determine layout and unit.
        fps: frames per second; None where the file states it.
        unit: of the positions; None to read it from the file, or to tell it from the size.
        up: axis that points up, or down; None to tell it from head and feet.
        hand: handedness of the axes; None to tell it from the body.
        layout: which keypoints an array without names holds; None to tell it.

    Raises:
        ValueError: when something cannot be told or cannot be right; the message says what was
            found and which option decides.
    """
    check_unit(unit)
    raw, hands = split_off_hands(raw)
    known = _upper_neck_renamed(_with_known_names(with_known_rate(raw, fps), body, layout))
    metres, unit_reason = _metres_per_unit(known, body, unit)
    visible = np.all(np.isfinite(known.positions), axis=-1)
    positions = np.where(visible[..., None], known.positions, 0.0)
    up, up_reason = _up_axis(known.names, positions, visible, up, known.name)
    if unit is None and known.unit is None and up in ("x-down", "y-down"):
        _refuse_fractions_of_images(known)
    names = known.names
    positions = positions @ (to_z_up(up).T * metres)
    factors, mirrored = right_handed_signs(names, positions, visible, hand)
    positions *= factors
    placed = not _is_root_relative(names, positions, visible)
    level = not up.endswith("down")
    said = [*known.decisions, unit_reason, up_reason, *mirrored]
    if not level and not placed and _stands_upright(names, positions, visible):
        level = True
        said.append("shoulders are straight above the ankles: the camera is taken to be level")
    elif not level:
        said.append("the frame is a camera's, which may be tilted: gravity is estimated")
    ground_known = level
    if placed:
        ground_known, reason = _ground_is_zero(names, positions, visible, level=level)
        said.append(reason)
    else:
        said.append(
            "relative to the pelvis: the data have no place in the world; path and height are "
            "inferred from the feet, which stand"
        )
    return PositionsFile(
        "keypoints3d", positions, visible, names, known.fps or 0.0, known.start_time, ground_known,
        level=level, placed=placed, decisions=tuple(said),
        fingers=hands and _turned_hand_points(hands.positions, to_z_up(up).T * metres * factors),
    )  # fmt: skip


def _turned_hand_points(
    positions: Float[np.ndarray, "time 42 3"], turn: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "time 42 4"]:
    """Multiply hand points by a matrix; append 1 where a point was seen, else 0."""
    seen = np.isfinite(positions).all(-1, keepdims=True)
    return np.concatenate((np.where(seen, positions, 0.0) @ turn, seen), -1)


def _with_known_names(raw: Points3D, body: BodyModel, layout: str | None) -> Points3D:
    """Return the points with names that recon knows; a note lists the other points."""
    if not raw.names:
        chosen, reason = settle_body_layout(raw.positions, layout or raw.layout, body, raw.name)
        names = keypoint_names(chosen)
        if chosen == "smpl22":
            names = tuple(str(name) for name in keypoints_of_labels(names))
        said = dict.fromkeys((*raw.decisions, reason))
        return replace(raw, names=names, decisions=tuple(said))
    meant = keypoints_of_labels(raw.names)
    kept = [k for k, name in enumerate(meant) if name is not None and name not in meant[:k]]
    unknown = [raw.names[k] for k in range(len(meant)) if k not in kept]
    names = tuple(str(meant[k]) for k in kept)
    if len(names) < _FEWEST:
        raise FormatError(
            f"{raw.name}: {len(names)} of its points are keypoints of a body by name "
            f"({', '.join(names) or 'none'}), which is too few; found {_first_names(raw.names)}, "
            "expected names such as left_hip, LKnee, RAnkle, nose"
        )
    said = [*raw.decisions, f"{len(names)} keypoints by name"]
    if limbs_of_bones(raw.names):
        said.append("the names are those of bones: each is the joint at which its bone begins")
    if unknown:
        said.append(f"points that are no keypoints of the body, left out: {_first_names(unknown)}")
    return replace(raw, names=names, positions=raw.positions[:, kept], decisions=tuple(said))


def _upper_neck_renamed(known: Points3D) -> Points3D:
    """Rename the neck to upper neck if it lies above the shoulders.

    Detectors call the middle of the shoulders a neck (OpenPose, HALPE), or its upper end
    (BODY_25B).
    """
    needed = ("neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
    names = known.names
    if not set(needed) <= set(names) or "upper_neck" in names:
        return known
    neck, *shoulders, left, right = (known.positions[:, names.index(n)] for n in needed)
    middle = (shoulders[0] + shoulders[1]) / 2
    up = middle - (left + right) / 2
    width = np.linalg.norm(shoulders[0] - shoulders[1], axis=-1)
    height = ((neck - middle) * up).sum(-1) / np.linalg.norm(up, axis=-1) / width
    height = height[np.isfinite(height)]
    if len(height) == 0 or float(np.median(height)) < _ABOVE:
        return known
    names = tuple("upper_neck" if name == "neck" else name for name in names)
    said = "the point neck is the upper end of the neck, as it lies above the shoulders"
    return replace(known, names=names, decisions=(*known.decisions, said))


def _first_names(names: tuple[str, ...] | list[str]) -> str:
    more = "" if len(names) <= 8 else f" and {len(names) - 8} more"
    return ", ".join(names[:8]) + more


def _metres_per_unit(known: Points3D, body: BodyModel, given: str | None) -> tuple[float, str]:
    """Return the metres per unit of a file's positions, and the reason."""
    name = known.name
    found = bone_lengths(known.positions, BodyPoints.of_names(known.names, body), body)
    unit, why = given or known.unit, "given" if given else "stated by the file"
    if found is None:
        if unit is None:
            raise UnitsError(
                f"{name}: too few bones are seen to tell the unit; give it with --unit"
            )
        return METRES[unit], f"unit {unit}: {why}"
    fitting = [one for one in ("m", "cm", "mm") if _SMALLEST < found.size * METRES[one] < _LARGEST]
    if unit is None and (found.misfit > 2 * GOOD or not fitting):
        _refuse_fractions_of_images(known)
    if found.misfit > 2 * GOOD:
        raise FormatError(
            f"{name}: the points do not form a body under their names: bones change their "
            "lengths, or nobody has such bones; check the names of the points"
        )
    if unit is None and not fitting:
        raise UnitsError(
            f"{name}: distances of the points are {found.size:.3g} times those of an average "
            "person in metres, so that the unit is not m, cm or mm"
            f"{hint_at_adult(_STATURE * found.size)}; scale them to metres, or give "
            "--unit; keypoints in pixels go into an .npz, keypoints=(frames, points, 3)"
        )
    size = found.size * METRES[unit or fitting[0]]
    if unit is None:
        return METRES[fitting[0]], f"unit {fitting[0]}: the body is {size:.2f} times average then"
    if not _SMALLEST < size < _LARGEST:
        hint = f"; give --unit {fitting[0]}" if fitting else ""
        raise UnitsError(
            f"{name}: the unit is {unit} ({why}), but then the body is {size:.3g} times as large "
            f"as an average person{hint}"
        )
    return METRES[unit], f"unit {unit}: {why}, the body is {size:.2f} times average"


def _refuse_fractions_of_images(known: Points3D) -> None:
    """Refuse points whose x and y are fractions of an image, with a depth or a score of [-1, 1].

    Raises:
        UnitsError: saying in which form they are read.
    """
    places = known.positions[np.isfinite(known.positions).all(-1)]
    inside = (np.abs(places - (0.5, 0.5, 0.0)) <= (0.5, 0.5, 1.0)).all(-1)
    if inside.mean() > _INSIDE:
        raise UnitsError(
            f"{known.name}: expected points in space, but nearly all x and y lie in [0, 1], as "
            "fractions of an image do (MediaPipe's landmarks; y, x and score of MoveNet). Write "
            "x · width, y · height (pixels) and a confidence into an .npz, "
            "keypoints=(frames, points, 3); if these are metres in space, give --unit m"
        )


def _up_axis(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    given: Up | None,
    name: str,
) -> tuple[Up, str]:
    """Return the up axis and the reason; it warns if the person would lie by a given axis."""
    try:
        found, reason = inferred_up(names, positions, visible, None, name)
    except UnitsError:
        if given is None:
            raise
        found, reason = given, ""
    if given is None:
        return found, reason
    lies = (
        f", with which the person lies; but {reason.partition(': ')[2]} along {found}: if the "
        f"person stands, leave --up out or give --up {found}"
    )
    return given, f"up axis {given}: given" + lies * (found != given)


def _is_root_relative(
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


def _stands_upright(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
) -> bool:
    """Return whether the shoulders are on average vertically above the ankles."""
    shoulders = [k for k, name in enumerate(names) if name in _SHOULDERS]
    ankles = [k for k, name in enumerate(names) if name in ("left_ankle", "right_ankle")]
    both = visible[:, shoulders].any(1) & visible[:, ankles].any(1)
    if not both.any():
        return False
    shown = np.where(visible[both][..., None], positions[both], np.nan)
    mean = (np.nanmean(shown[:, shoulders], 1) - np.nanmean(shown[:, ankles], 1)).mean(0)
    return bool(np.linalg.norm(mean[:2]) < _STRAIGHT * mean[2])


def _ground_is_zero(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    *,
    level: bool,
) -> tuple[bool, str]:
    """Return whether the ground is known to be at z = 0, and the reason."""
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
