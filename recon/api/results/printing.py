"""A result in a few lines for the person at the terminal; never a tensor."""

from collections.abc import Sequence

from recon.core.motion import Motion
from recon.diagnosis.fits.summaries import ResidualSummary

_KNOWN, _FINDINGS = 3, 4
"""Lines of them at most."""
WIDEST = 96
"""Characters of a line."""


def in_ten_lines(first: str, known: Sequence[str], found: Sequence[str]) -> str:
    """A headline, what is known, and what was found.

    Args:
        first: the headline.
        known: lines, such as one for every observation.
        found: repairs and warnings.
    """
    lines = [*shortened(known, _KNOWN, "lines"), *shortened(found, _FINDINGS, "findings")]
    return "\n".join([first, *map(one_line, lines)])


def described_motion(motion: Motion, tall: float) -> str:
    """How long a motion of one clip lasts, and how tall the person is, metres."""
    seconds = (motion.frames - 1) / motion.fps
    return (
        f"{motion.frames} frames, {seconds:.2f} s at {motion.fps:g} frames per second, "
        f"a person of {tall:.2f} m"
    )


def described_residuals(residuals: Sequence[ResidualSummary]) -> list[str]:
    """How near the fit is to every observation, one line each."""
    return [_sensor(one) for one in residuals]


def _sensor(one: ResidualSummary) -> str:
    """An observation in one line."""
    seen = "nothing seen" if one.median is None else f"median residual {_size(one.median, one)}"
    return f"{one.name}: noise {_size(one.noise, one)}, {seen}"


def _size(value: float, one: ResidualSummary) -> str:
    if one.unit == "metres":
        return f"{100 * value:.1f} cm"
    return f"{value:.{2 if one.unit == 'radians' else 1}f} {one.unit}"


def one_line(text: str) -> str:
    """The beginning of a message, indented, in one line."""
    text = "  " + " ".join(text.split())
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."


def shortened(lines: Sequence[str], count: int, noun: str) -> list[str]:
    """The first lines, and how many more there are."""
    if len(lines) <= count:
        return list(lines)
    return [*lines[:count], f"and {len(lines) - count} more {noun}"]
