"""Finds the cuts of a film while it is decoded."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

Picture = tuple[UInt8[np.ndarray, "height width 3"], float]
"""An RGB image and its time, seconds."""
_Small = Float32[np.ndarray, "32 32 3"]

_SIDE = 32
"""Side (pixels) of the small images that are compared."""
_MOST_SHIFT = 2
"""Largest shift (pixels of small images) between pictures that a knock to the camera explains."""
_AROUND = 3
"""Steps before and after a cut with which it is compared; more pictures than a flash lasts."""
_DIFFERENT = 0.05
"""Difference of two pictures from which there may be a cut between them: 0.01 is reached by people
near the camera at 60 Hz, 0.05 to 0.7 by two views of one room."""
_BLACKOUT = 0.15
"""Difference from which there may be a cut in blank pictures, while people go on moving."""
_LEAST_RATIO = 4.0
"""Least ratio of the difference at a cut to the largest difference at the steps around it."""
_BLANK = 4.0
"""Standard deviation of colours (of 255) up to which a picture counts as blank."""


def with_shots(pictures: Iterable[Picture]) -> Iterator[tuple[Picture, int]]:
    """Yield each picture with the number of its shot, which rises by one at every cut.

    A cut is a step between two pictures far larger than the steps around it, after which the
    pictures stay different. So pans, fast people, flashes, knocks of the camera and lights that
    are switched are no cuts; nor are dissolves. The output lags three pictures behind.
    """
    shot = 0
    shown: _Small | None = None
    past: deque[_Small | None] = deque(maxlen=_AROUND + 1)
    waiting: deque[tuple[Picture, _Small | None]] = deque()

    def next_picture() -> tuple[Picture, int]:
        nonlocal shot, shown
        shot += shown is not None and _is_cut(shown, past, [small for _, small in waiting])
        picture, small = waiting.popleft()
        past.append(small)
        shown = shown if small is None else small
        return picture, shot

    for picture in pictures:
        waiting.append((picture, _thumbnail(picture[0])))
        if len(waiting) > _AROUND:
            yield next_picture()
    while waiting:
        yield next_picture()


def _is_cut(shown: _Small, past: Sequence[_Small | None], coming: Sequence[_Small | None]) -> bool:
    """Return whether a new shot begins with the first of the coming pictures.

    Args:
        shown: the latest picture that is not blank.
        past: the pictures before the possible cut, None where one is blank.
        coming: the pictures after it.
    """
    if coming[0] is None:
        return False
    least = _BLACKOUT if past[-1] is None else _DIFFERENT
    step = _dissimilarity(shown, coming[0])
    if step < least:
        return False
    if any(_dissimilarity(shown, one) < least for one in coming[1:] if one is not None):
        return False
    if past[-1] is None:
        return True
    around = [*pairwise(past), *pairwise(coming)]
    return step > _LEAST_RATIO * max(
        (_dissimilarity(a, b) for a, b in around if a is not None and b is not None), default=0.0
    )


def _thumbnail(image: UInt8[np.ndarray, "height width 3"]) -> _Small | None:
    """Shrink an image to 32 x 32 pixels; return None where it is blank."""
    step = max(1, min(image.shape[:2]) // (4 * _SIDE))
    part = np.ascontiguousarray(image[::step, ::step])
    small = cv2.resize(part, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)
    return None if small.std((0, 1)).max() <= _BLANK else small


def _dissimilarity(a: _Small, b: _Small) -> float:
    """Return 1 - correlation of two images, shifted to match best: 0 is alike, 1 unrelated."""
    inner = b[_MOST_SHIFT:-_MOST_SHIFT, _MOST_SHIFT:-_MOST_SHIFT]
    return 1.0 - float(cv2.matchTemplate(a, inner, cv2.TM_CCOEFF_NORMED).max())
