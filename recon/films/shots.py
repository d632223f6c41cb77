"""Finds the cuts of a film while it is decoded."""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import UInt8

Picture = tuple[UInt8[np.ndarray, "height width 3"], float]
"""An RGB image and its time, seconds."""


def with_shots(pictures: Iterable[Picture]) -> Iterator[tuple[Picture, int]]:
    """Pictures with the number of their shot, which rises by one at every cut."""
    for picture in pictures:
        yield picture, 0
