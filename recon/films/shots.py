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
"""Pixels of a side of the small images that are compared."""
_KNOCK = 2
"""Of these pixels by which a camera may be knocked from one picture to the next."""
_AROUND = 3
"""Steps before and after a cut that it is compared with; longer than a flash."""
_DIFFERENT = 0.05
"""Difference of two pictures from which there may be a cut between them: 0.01 is reached by people
near the camera at 60 Hz, 0.05 to 0.7 by two views of one room."""
_BLACKOUT = 0.15
"""The same across blank pictures, during which people go on moving."""
_ALONE = 4.0
"""A cut differs by so many times what the steps around it do."""
_BLANK = 4.0
"""Standard deviation, of 255, up to which a picture shows nothing."""


def with_shots(pictures: Iterable[Picture]) -> Iterator[tuple[Picture, int]]:
    """Pictures with the number of their shot, which rises by one at every cut.

    A cut is a step between two pictures far larger than the steps around it, after which the
    pictures stay different. So pans, fast people, flashes, knocks of the camera and lights that
    are switched are none; a dissolve is none either. Three pictures are held back.
    """
    shot = 0
    shown: _Small | None = None
    past: deque[_Small | None] = deque(maxlen=_AROUND + 1)
    waiting: deque[tuple[Picture, _Small | None]] = deque()

    def next_one() -> tuple[Picture, int]:
        nonlocal shot, shown
        shot += shown is not None and _is_cut(shown, past, [small for _, small in waiting])
        picture, small = waiting.popleft()
        past.append(small)
        shown = shown if small is None else small
        return picture, shot

    for picture in pictures:
        waiting.append((picture, _thumbnail(picture[0])))
        if len(waiting) > _AROUND:
            yield next_one()
    while waiting:
        yield next_one()


def _is_cut(shown: _Small, past: Sequence[_Small | None], coming: Sequence[_Small | None]) -> bool:
    """Whether a shot begins with the first of the coming pictures.

    Args:
        shown: the latest picture that shows something.
        past: the pictures before the cut, None where one is blank.
        coming: those after it.
    """
    if coming[0] is None:
        return False
    least = _BLACKOUT if past[-1] is None else _DIFFERENT
    step = _difference(shown, coming[0])
    if step < least:
        return False
    if any(_difference(shown, one) < least for one in coming[1:] if one is not None):
        return False
    if past[-1] is None:
        return True
    around = [*pairwise(past), *pairwise(coming)]
    return step > _ALONE * max(
        (_difference(a, b) for a, b in around if a is not None and b is not None), default=0.0
    )


def _thumbnail(image: UInt8[np.ndarray, "height width 3"]) -> _Small | None:
    """The image as a few pixels; None where it shows nothing."""
    step = max(1, min(image.shape[:2]) // (4 * _SIDE))
    part = np.ascontiguousarray(image[::step, ::step])
    small = cv2.resize(part, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)
    return None if small.std((0, 1)).max() <= _BLANK else small


def _difference(a: _Small, b: _Small) -> float:
    """One minus the correlation of two images, shifted onto each other: 0 alike, 1 unrelated."""
    inner = b[_KNOCK:-_KNOCK, _KNOCK:-_KNOCK]
    return 1.0 - float(cv2.matchTemplate(a, inner, cv2.TM_CCOEFF_NORMED).max())
