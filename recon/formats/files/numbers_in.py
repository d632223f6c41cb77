"""Numbers written as text, read piece by piece: a list of all words would take ten times more."""

import numpy as np

from recon.core.errors import FormatError

_PIECE = 1 << 20
"""Characters looked at together."""
_LONGEST = 1000
"""Characters a number may have."""


def numbers_in(text: str | bytes, count: int, start: int = 0) -> np.ndarray:
    """An array of `count` numbers between white space, from a place in the text to its end.

    Raises:
        ValueError: when there are more or fewer, or something is no number.
    """
    values, filled = np.empty(count), 0
    while start < len(text):
        end = start + _PIECE
        stop = min(end + _LONGEST, len(text))
        while end < stop and not text[end : end + 1].isspace():
            end += 1
        words = text[start:end].split()
        if filled + len(words) > count:
            raise FormatError(f"expected {count} numbers, got more")
        values[filled : filled + len(words)] = [float(word) for word in words]
        filled, start = filled + len(words), end
    if filled < count:
        raise FormatError(f"expected {count} numbers, got {filled}")
    return values
