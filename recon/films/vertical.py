"""Finds the vertical and focal length of a still camera from straight lines in its images.

Edges of walls, doors, windows and furniture are mostly vertical, or along two horizontal
directions at right angles (Coughlan and Yuille, "Manhattan World", 1999). A segment in an image
and the centre of the camera span a plane with a unit normal n; the segment may show a line of
direction d only where n·d = 0. Pairs of segments propose vertical directions, for every focal
length of a grid. The best one explains, with two horizontal directions, the largest share of the
length of all segments, where cameras that are rolled or look far up or down count for less.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

_LONGEST_SIDE = 1280
"""Longer side (pixels) to which larger images are reduced before segments are looked for."""
_SHORTEST_SEGMENT = 0.03
"""Least length of a segment, as a share of the image's longer side."""
_FEWEST_SEGMENTS = 20
_TOLERANCE = np.radians(1.2)
"""Standard deviation of the angle between the plane of a segment and the direction it shows."""
_MOST_TILTED = np.radians(50.0)
"""Largest angle between the vertical and the image's own up axis that is considered."""
_ROLL, _PITCH, _PITCH_SPREAD = np.radians(20.0), np.radians(8.0), np.radians(30.0)
"""Standard deviation of a camera's roll; mean and standard deviation of the angle by which it
looks down. Lines that imply a camera far from these are mostly those of furniture or textures."""
_FOCAL_LENGTHS = np.geomspace(0.55, 1.65, 23)
"""Focal lengths tried, over the longer side: fields of view from 85 to 34 degrees along it."""
_MOST_OFF = 3.0
"""Largest difference of a focal length from its guess, in standard deviations."""
_PAIRS = 300
"""Pairs of segments that propose a vertical for each focal length."""
_HEADINGS = 90
"""Bins of the quarter turn in which the heading of a horizontal direction lies."""
_LEAST_VERTICAL = 0.05
"""Share of the length of all segments that the vertical must explain by itself."""
_BEYOND_CHANCE = 0.12
"""Least explained share, beyond that of segments turned at random, at which a vertical counts."""
_RANDOM_TURNS = 5
_RIVAL, _APART = 0.8, np.radians(10.0)
"""Largest share beyond chance explained by another vertical, over that of the best one, and least
angle between both; where it explains more, lines determine no single vertical."""
_STEP, _PEAK = 0.12, 0.92
"""Logarithm of a change of the focal length by which the explained share must fall, to this share
of its greatest value, for lines to tell the focal length."""
_EVERY_IMAGE = 0.6
"""Least explained share in an image, over the mean of all; if a camera turns, it is lower."""


@dataclass(frozen=True)
class Vertical:
    """The up direction in a camera's frame, and the focal length that lines imply."""

    up: Float[np.ndarray, "3"]
    """Unit vector in the camera's frame: x right, y down, z forward."""
    focal: float | None
    """Focal length in pixels; None where the lines do not tell it."""


def find_vertical(
    images: Sequence[Float[np.ndarray, "_ 2 2"]],
    longer_side: int,
    focal: float,
    focal_std: float,
) -> Vertical | None:
    """Find the vertical in images of one still camera; None where lines do not determine it.

    They do not where there are few, where they explain little more than lines turned at random,
    where another vertical explains nearly as many, and where images disagree because the camera
    turns.

    Args:
        images: ends of the straight segments of each image, pixels from the principal point; of
            a film five images are enough.
        longer_side: the longer side of the images, pixels.
        focal: focal length in pixels; its guess where it is not known.
        focal_std: its standard deviation as a share of it; 0 where it is known. Else it is looked
            for within three of them, and the guess is taken where lines do not tell it.
    """
    known = focal_std == 0
    segments = np.concatenate([np.zeros((0, 2, 2)), *images])
    if len(segments) < _FEWEST_SEGMENTS or not _may_be_vertical(segments).any():
        return None
    generator = np.random.default_rng(0)
    lengths = longer_side * _FOCAL_LENGTHS
    lengths = lengths[np.abs(np.log(lengths / focal)) <= _MOST_OFF * focal_std]
    if len(lengths) == 0:
        lengths, known = np.full(1, focal), True
    proposals = [_best_vertical(segments, one, generator) for one in lengths]
    shares = np.array([share for _, share, _ in proposals])
    best = int(shares.argmax())
    focal_found = not known and _is_peak(np.log(lengths), shares, best)
    if not known and not focal_found:
        up, share, rival = _best_vertical(segments, focal, generator)
    else:
        (up, share, rival), focal = proposals[best], float(lengths[best])
    by_chance = _share_by_chance(segments, lengths[::4], generator)
    if share < by_chance + _BEYOND_CHANCE or rival - by_chance > _RIVAL * (share - by_chance):
        return None
    own = [_explained_share(one, focal, up[None])[0] for one in images if len(one) > 0]
    if min(own) < _EVERY_IMAGE * np.mean(own):
        return None
    return Vertical(up, focal if focal_found else None)


def straight_segments(
    image: UInt8[np.ndarray, "height width 3"],
) -> Float[np.ndarray, "segments 2 2"]:
    """Find the long straight segments of an image; return their ends, pixels."""
    longer = max(image.shape[:2])
    scale = min(1.0, _LONGEST_SIDE / longer)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    lines = cv2.createLineSegmentDetector().detect(grey)[0]
    if lines is None:
        return np.zeros((0, 2, 2))
    ends = lines.reshape(-1, 2, 2).astype(np.float64) / scale
    return ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) > _SHORTEST_SEGMENT * longer]


def _may_be_vertical(segments: Float[np.ndarray, "segments 2 2"]) -> np.ndarray:
    """Return which segments are steep enough in the image to be vertical in the world."""
    along = np.abs(segments[:, 1] - segments[:, 0])
    return np.arctan2(along[:, 0], along[:, 1]) < _MOST_TILTED


def _turned_at_random(
    segments: Float[np.ndarray, "segments 2 2"], generator: np.random.Generator
) -> Float[np.ndarray, "segments 2 2"]:
    """Return the segments, each turned about its middle by a random angle."""
    middle = segments.mean(1, keepdims=True)
    angle = generator.uniform(0, np.pi, len(segments))
    turns = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return middle + np.einsum("ijs,skj->ski", turns, segments - middle)


def _share_by_chance(
    segments: Float[np.ndarray, "segments 2 2"],
    lengths: Float[np.ndarray, " focals"],
    generator: np.random.Generator,
) -> float:
    """Return the largest explained share in several copies of segments, turned at random."""
    turned = [_turned_at_random(segments, generator) for _ in range(_RANDOM_TURNS)]
    return max(_best_vertical(one, focal, generator)[1] for one in turned for focal in lengths)


def _best_vertical(
    segments: Float[np.ndarray, "segments 2 2"], focal: float, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "3"], float, float]:
    """Return the vertical proposed by pairs of segments that explains most, and its share.

    Also returned is the largest share of one in another direction. Shares are multiplied by the
    likelihood of the camera's roll and pitch.
    """
    length, normals = _segment_lengths(segments), _plane_normals(segments, focal)
    steep = np.flatnonzero(_may_be_vertical(segments))
    if len(steep) == 0:
        return np.array([0.0, -1.0, 0.0]), 0.0, 0.0
    first, second = generator.choice(steep, (2, _PAIRS), p=length[steep] / length[steep].sum())
    across = np.cross(normals[first], normals[second])
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    ups = (across / np.maximum(size, 1e-9) * -np.sign(across[:, 1:2]))[size[:, 0] > 1e-2]
    ups = ups[-ups[:, 1] > np.cos(_MOST_TILTED)]
    if len(ups) == 0:
        return np.array([0.0, -1.0, 0.0]), 0.0, 0.0
    share = _explained_share(segments, focal, ups) * _camera_likelihood(ups)
    best = int(share.argmax())
    rival = share[ups @ ups[best] < np.cos(_APART)].max(initial=0.0)
    return ups[best], float(share[best]), float(rival)


def _camera_likelihood(ups: Float[np.ndarray, "ups 3"]) -> Float[np.ndarray, " ups"]:
    """Return the likelihood of a camera's roll and pitch, given its up direction; at most 1."""
    roll, down = np.arctan2(ups[:, 0], -ups[:, 1]), np.arcsin(np.clip(-ups[:, 2], -1, 1))
    return np.exp(-0.5 * ((roll / _ROLL) ** 2 + ((down - _PITCH) / _PITCH_SPREAD) ** 2))


def _explained_share(
    segments: Float[np.ndarray, "segments 2 2"], focal: float, ups: Float[np.ndarray, "ups 3"]
) -> Float[np.ndarray, " ups"]:
    """Return the share of segments' length that each vertical and two horizontals explain.

    It is zero where the vertical explains too little by itself.
    """
    length, normals = _segment_lengths(segments), _plane_normals(segments, focal)
    off = np.arcsin(np.clip(ups @ normals.T, -1, 1)) / _TOLERANCE
    vertical = np.exp(-0.5 * off**2)
    # two horizontal directions for each vertical are axes in which headings of lines are measured
    ahead = np.cross(ups, (0.0, 0.0, 1.0))
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    aside = np.cross(ups, ahead)
    # coordinates of n × up, along which a horizontal line in the plane of normal n points
    x, y = aside @ normals.T, -(ahead @ normals.T)
    heading = np.arctan2(y, x) % (np.pi / 2) * (2 / np.pi * _HEADINGS)
    bins = heading.astype(np.int64) % _HEADINGS + _HEADINGS * np.arange(len(ups))[:, None]
    # n × up vanishes where the segment and the camera span a nearly level plane: no heading
    left = length * (1 - vertical) * (np.hypot(x, y) > 0.2)
    histogram = np.bincount(bins.ravel(), left.ravel(), _HEADINGS * len(ups))
    histogram = histogram.reshape(len(ups), _HEADINGS)
    horizontal = (histogram + np.roll(histogram, 1, axis=1)).max(1)
    alone = vertical @ length
    share = (alone + horizontal) / length.sum()
    return np.where(alone > _LEAST_VERTICAL * length.sum(), share, 0.0)


def _segment_lengths(
    segments: Float[np.ndarray, "segments 2 2"],
) -> Float[np.ndarray, " segments"]:
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)


def _plane_normals(
    segments: Float[np.ndarray, "segments 2 2"], focal: float
) -> Float[np.ndarray, "segments 3"]:
    """Return unit normals of the planes through the segments and the centre of the camera."""
    rays = np.concatenate((segments / focal, np.ones((len(segments), 2, 1))), -1)
    across = np.cross(rays[:, 0], rays[:, 1])
    return across / np.linalg.norm(across, axis=-1, keepdims=True)


def _is_peak(
    logarithms: Float[np.ndarray, " focals"], shares: Float[np.ndarray, " focals"], best: int
) -> bool:
    """Return whether the explained share falls clearly on both sides of its greatest value."""
    beside = logarithms[best] + np.array([-_STEP, _STEP])
    if beside[0] < logarithms[0] or beside[1] > logarithms[-1]:
        return False
    return bool((np.interp(beside, logarithms, shares) < _PEAK * shares[best]).all())
