"""A result in a few lines for the person at the terminal; never a tensor."""

from collections.abc import Sequence

from recon.core.motion import Motion
from recon.diagnosis.fits.summaries import ResidualSummary

_SENSORS, _FINDINGS = 3, 4
"""Lines of them at most."""


def in_ten_lines(
    motion: Motion,
    tall: float,
    failed: bool,
    residuals: Sequence[ResidualSummary],
    found: Sequence[str],
) -> str:
    """How long, who, how near the data, and what was found.

    Args:
        motion: one clip.
        tall: height of the person, metres.
        failed: whether the fit met NaN or infinity.
        residuals: of every observation.
        found: repairs and warnings.
    """
    seconds = (motion.frames - 1) / motion.fps
    first = (
        f"Result: {motion.frames} frames, {seconds:.2f} s at {motion.fps:g} frames per second, "
        f"a person of {tall:.2f} m" + (", FAILED: NaN or infinity" if failed else "")
    )
    sensors = _most([_sensor(one) for one in residuals], _SENSORS, "observations")
    return "\n".join(
        [first, *sensors, *_most([_line(one) for one in found], _FINDINGS, "findings")]
    )


def _sensor(one: ResidualSummary) -> str:
    """An observation in one line."""
    seen = "nothing seen" if one.median is None else f"median residual {_size(one.median, one)}"
    return f"  {one.name}: noise {_size(one.noise, one)}, {seen}"


def _size(value: float, one: ResidualSummary) -> str:
    return f"{100 * value:.1f} cm" if one.unit == "metres" else f"{value:.1f} {one.unit}"


def _line(text: str, most: int = 96) -> str:
    """The beginning of a message, in one line."""
    text = "  " + " ".join(text.split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _most(lines: Sequence[str], count: int, noun: str) -> list[str]:
    """The first lines, and how many more there are."""
    if len(lines) <= count:
        return list(lines)
    return [*lines[:count], f"  and {len(lines) - count} more {noun}"]
