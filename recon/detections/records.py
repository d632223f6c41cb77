"""Records of 2D keypoints in the images of one camera, with any number of people per frame."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import FormatError
from recon.core.layouts import LAYOUTS, keypoint_names
from recon.core.limits import FRAME_NUMBER, KEYPOINTS, PEOPLE, PERSON, PIXEL, SCORE

_BY_COUNT = {
    17: "coco17", 23: "coco133", 26: "halpe26", 33: "mediapipe33", 133: "coco133", 136: "halpe26"
}  # fmt: skip
"""Detectors of 17 keypoints are COCO's unless told; 133 and 136 add face and hands to a body."""

_BODY_PART = {("coco133", 133): 23, ("halpe26", 136): 26}
"""Keypoints at the head of a longer layout."""

_HANDS_AT = {60: 18, 67: 25, 75: 33, 133: 91, 136: 94}
"""First of the 42 points of hands by the number of keypoints: after OpenPose's and MediaPipe's
bodies, and after body, feet and face of COCO-WholeBody and HALPE."""
_HANDS = 42

_COCO18 = (*range(8), *range(9, 19))
"""Indices of the keypoints of OpenPose's COCO model in BODY_25, which adds hips and feet."""

_BONES = tuple(
    (f"{side}_{upper}", f"{side}_{lower}")
    for side in ("left", "right")
    for upper, lower in (
        ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
        ("shoulder", "hip"), ("ankle", "heel"), ("eye", "ear"),
    )
)  # fmt: skip
_MIN_BONES = 6
"""Bones a person must show in both readings to have a say."""
_CONFIDENT = 0.3
_PERCENT = 12.0
"""Median above which confidences are in per cent; scores that are not normalised get to 10."""
_SHORTER = 0.75
"""The right reading has bones at most this much of the length of the wrong one's."""
_AGREEMENT = 0.8
"""Share of the people that must agree."""


def recognised_layout(
    points: Float[np.ndarray, "rows points 3"], layout: str | None, name: str
) -> tuple[str, Float[np.ndarray, "rows known 3"], str]:
    """Tell the layout of keypoints; return its name, keypoints in its order, and a note.

    25 keypoints may be OpenPose's BODY_25 or BODY_25B: read the wrong way, arms and legs join
    points far apart, so the reading in which the bones are shorter is right. 18 are OpenPose's
    COCO model and become `openpose25` without middle of the hips and feet; of 133 and 136 the
    body part is kept.

    Raises:
        ValueError: when the layout has another number of keypoints, or cannot be told.
    """
    count = points.shape[1]
    if layout is not None:
        points = points[:, : _BODY_PART.get((layout, count), count)]
        if layout == "openpose25" and count == len(_COCO18):
            return (layout, _from_coco18(points), f"layout {layout}: given, 18 of its keypoints")
        if len(keypoint_names(layout)) != points.shape[1]:
            raise FormatError(
                f"{name}: layout {layout} has {len(keypoint_names(layout))} keypoints, the file "
                f"{count}; give the right one with --layout"
            )
        return layout, points, f"layout {layout}: given"
    if count == len(_COCO18):
        return ("openpose25", _from_coco18(points), "layout openpose25: 18 keypoints, COCO model")
    if count == len(LAYOUTS["openpose25"]):
        chosen = _openpose_layout(points, name)
        return (
            chosen,
            points,
            f"layout {chosen}: 25 keypoints, whose arms and legs are whole only in this order",
        )
    if count not in _BY_COUNT:
        raise FormatError(
            f"{name}: no known layout has {count} keypoints; give one of "
            f"{', '.join(LAYOUTS)} with --layout"
        )
    chosen = _BY_COUNT[count]
    kept = points[:, : _BODY_PART.get((chosen, count), count)]
    return chosen, kept, f"layout {chosen}: {count} keypoints"


def _from_coco18(points: np.ndarray) -> np.ndarray:
    out = np.zeros((len(points), len(LAYOUTS["openpose25"]), 3))
    out[:, list(_COCO18)] = points
    return out


def _openpose_layout(points: np.ndarray, name: str) -> str:
    first, second = "openpose25", "openpose25b"
    ratio = _bone_length(points, first) / _bone_length(points, second)
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) > 0:
        if (ratio <= _SHORTER).mean() >= _AGREEMENT:
            return first
        if (ratio >= 1 / _SHORTER).mean() >= _AGREEMENT:
            return second
    raise FormatError(
        f"{name}: 25 keypoints may be OpenPose's BODY_25 or BODY_25B, and "
        + ("nobody is seen clearly enough" if len(ratio) == 0 else "people fit neither well")
        + f"; give --layout {first} or --layout {second}"
    )


def _bone_length(points: np.ndarray, layout: str) -> np.ndarray:
    """Return each row's mean length of visible bones, pixels; NaN if too few are visible."""
    index = {name: k for k, name in enumerate(keypoint_names(layout))}
    pairs = np.array([(index[a], index[b]) for a, b in _BONES])
    seen = (points[:, pairs, 2] >= _CONFIDENT).all(-1)
    ends = points[:, pairs, :2]
    length = np.where(seen, np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1), 0.0)
    count = seen.sum(1)
    enough = (count >= _MIN_BONES) & (length.sum(1) > 0)
    return np.where(enough, length.sum(1) / np.maximum(count, 1), np.nan)


Row = tuple[int, np.ndarray, int]
"""Frame number, (keypoints, 3) of x, y, confidence, and the person's number or -1."""


@dataclass(frozen=True)
class Background:
    """Tracks of background points in a film whose camera moves: frame, point and pixels."""

    frame: Int[np.ndarray, " seen"]
    """The frame number of each place."""
    point: Int[np.ndarray, " seen"]
    """The number of its point, from 0."""
    pixels: Float[np.ndarray, "seen 2"]


@dataclass(frozen=True)
class Detections:
    """People whom a detector found in one view; one row per person and frame."""

    name: str
    """Name of the folder or file."""
    layout: str
    """One of `recon.core.layouts.LAYOUTS`."""
    frame_numbers: Int[np.ndarray, " frames"]
    """Frames that were looked at, increasing; also those without anybody."""
    frame: Int[np.ndarray, " rows"]
    """The frame number of each row; rows of a frame in the order of the file."""
    pixels: Float[np.ndarray, "rows points 2"]
    """Zero where the confidence is zero."""
    confidence: Float[np.ndarray, "rows points"]
    """Confidence from 0 (missing) to 1."""
    identity: Int[np.ndarray, " rows"]
    """The number the producer gave to a person, -1 for none."""
    hands: Float[np.ndarray, "rows 42 3"] | None = None
    """Pixels and confidence of `recon.core.fingers.FINGER_POINTS`; zero where not seen."""
    decisions: tuple[str, ...] = ()
    """What was decided about the file and why."""
    frame_rate: float | None = None
    """Frames per second, where the file tells."""
    image_size: tuple[int, int] | None = None
    """Width and height of the images, pixels, where the file tells."""
    stated_focal: float | None = None
    """Focal length for 35 mm film, millimetres, where the camera wrote it into a film."""
    lines: Float[np.ndarray, "lines 2 2"] | None = None
    """Ends of straight segments in some images of a film, pixels."""
    lines_frame: Int[np.ndarray, " lines"] | None = None
    """The frame number of each."""
    shots: tuple[int, ...] = ()
    """Frame numbers with which shots after the first begin, of a film with cuts."""
    background: Background | None = None
    """None where the camera stands still, or there is no film."""


def detections_of_rows(
    name: str,
    frame_numbers: Sequence[int],
    rows: Sequence[Row],
    *,
    layout: str | None = None,
    decisions: tuple[str, ...] = (),
) -> Detections:
    """Make `Detections` from rows of frame number, keypoints and person number.

    Confidences in per cent are divided by 100, others clipped to [0, 1]. A keypoint is missing
    where its confidence is zero, or its place is NaN, infinite, (0, 0), or -1 in both coordinates.

    Raises:
        ValueError: when nobody was found at all, rows have different lengths, or the layout
            cannot be told.
    """
    rows = [row for row in rows if len(row[1]) > 0]
    if len(rows) == 0:
        raise FormatError(
            f"{name}: expected people, but all {len(frame_numbers)} frames are empty of 2D "
            "keypoints with a confidence above zero; run the detector again, write its "
            "confidences, or leave this view out"
        )
    _check_sizes(name, frame_numbers, rows)
    points = _stacked_keypoints(name, [row[1] for row in rows])
    SCORE.check(points[..., 2], name, "[person, keypoint]", seen=np.isfinite(points[..., 2]))
    given = points[..., 2][points[..., 2] > 0]
    if len(given) > 0 and _PERCENT < float(np.median(given)) <= given.max() <= 100:
        points = points / (1.0, 1.0, 100.0)
        decisions += ("confidences up to 100 were taken as per cent",)
    points = with_clipped_confidences(points)
    PIXEL.check(points[..., :2], name, "[person, keypoint, axis]")
    count = len(points[0])
    first = _HANDS_AT.get(count, count)
    hands = points[:, first : first + _HANDS]
    hands = hands if (hands[..., 2] > 0).any() else None
    if hands is not None:
        decisions += (f"{_HANDS} points of hands, which fingers are fitted to",)
    body = points if count in _BY_COUNT else points[:, :first]
    chosen, body, decision = recognised_layout(body, layout, name)
    return Detections(
        name=name,
        layout=chosen,
        frame_numbers=np.array(frame_numbers, dtype=np.int64),
        frame=np.array([row[0] for row in rows], dtype=np.int64),
        pixels=body[..., :2],
        confidence=body[..., 2],
        identity=np.array([row[2] for row in rows], dtype=np.int64),
        hands=hands,
        decisions=(*decisions, decision),
    )


def _stacked_keypoints(
    name: str, keypoints: Sequence[Float[np.ndarray, "points 3"]]
) -> Float[np.ndarray, "rows points 3"]:
    """Stack everybody's keypoints; who has none of the hands that others have gets zeros there."""
    lengths = sorted({len(one) for one in keypoints})
    if len(lengths) > 1 and lengths != [_HANDS_AT.get(lengths[-1]), lengths[-1]]:
        raise FormatError(
            f"{name}: expected the same number of keypoints for all people, got "
            f"{' and '.join(map(str, lengths))}"
        )
    longest = lengths[-1]
    return np.stack([
        one if len(one) == longest else np.pad(one, ((0, longest - len(one)), (0, 0)))
        for one in keypoints
    ])  # fmt: skip


def _check_sizes(name: str, frame_numbers: Sequence[int], rows: Sequence[Row]) -> None:
    """Refuse impossible frame and person numbers before memory is allocated for them.

    Raises:
        ValueError: naming file, quantity and what came.
    """
    FRAME_NUMBER.check(max(frame_numbers), name, "frame number")
    KEYPOINTS.check(len(rows[0][1]), name)
    PERSON.check(max(row[2] for row in rows), name, "number of the person")
    frame, people = Counter(row[0] for row in rows).most_common(1)[0]
    PEOPLE.check(people, name, f"frame {frame}")


def with_clipped_confidences(
    points: Float[np.ndarray, "rows points 3"],
) -> Float[np.ndarray, "rows points 3"]:
    """Clip confidences of keypoints to [0, 1], and set missing keypoints to zeros."""
    finite = np.isfinite(points).all(-1)
    place = points[..., :2]
    nowhere = (place == 0).all(-1) | (place == -1).all(-1)
    seen = finite & ~nowhere & (points[..., 2] > 0)
    confidence = np.clip(np.where(seen, points[..., 2], 0.0), 0.0, 1.0)
    return np.concatenate((np.where(seen[..., None], place, 0.0), confidence[..., None]), -1)
