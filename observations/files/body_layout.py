"""Which keypoints the points of an array are: every layout would make another body of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from observations.correspondences import BodyPoints
from recon.body.model import BodyModel
from recon.core.errors import FormatError
from recon.core.layouts import LAYOUTS, keypoint_names

GOOD = 0.35
"""Misfit up to which points may be a body in a layout; those of real people are below a half of
it, those of a wrong layout above twice of it."""
_BETTER = 0.6
"""Share of the second best misfit up to which the best is clearly the right one."""
_FEWEST = 4
"""Distances along bones without which no size is told."""
_LONG = 0.1
"""Metres at rest from which on a distance says more of a body than of noise."""
_MOMENTS = 400
"""Moments that are looked at."""


@dataclass(frozen=True)
class Lengths:
    """Distances of points along bones, against those of the average body."""

    size: float
    """Median ratio: the unit in metres, for a body as large as the average one, inverted."""
    misfit: float
    """Mean over the distances of how far each is from this size (relative, at most 1), and of how
    much it varies (relative, at most 1)."""


def bone_lengths(
    positions: Float[np.ndarray, "time points 3"], points: BodyPoints, body: BodyModel
) -> Lengths | None:
    """How points agree with a body of any size; None where too few distances are seen."""
    rest = points.at_rest(body, body.template.new_zeros(body.shape_size)).double().numpy()
    some = positions[:: max(len(positions) // _MOMENTS, 1)]
    ratios: list[float] = []
    spreads: list[float] = []
    apart = np.linalg.norm(rest[:, None] - rest[None], axis=-1)
    for a, b in points.rigid_pairs(body):
        if apart[a, b] < _LONG:
            continue
        length = np.linalg.norm(some[:, a] - some[:, b], axis=-1)
        length = length[np.isfinite(length)]
        if len(length) == 0:
            continue
        middle = float(np.median(length))
        ratios.append(middle / float(apart[a, b]))
        spreads.append(float(np.median(np.abs(length - middle))) / max(middle, 1e-12))
    if len(ratios) < _FEWEST:
        return None
    size = float(np.median(ratios))
    away = np.minimum(np.abs(np.array(ratios) / max(size, 1e-12) - 1), 1.0)
    return Lengths(size, float(away.mean() + np.minimum(spreads, 1.0).mean()))


def settle_body_layout(
    positions: Float[np.ndarray, "time points 3"],
    layout: str | None,
    body: BodyModel,
    name: str,
) -> tuple[str, str]:
    """The layout of an array without names, and the reason.

    Args:
        positions: in any unit and axes; NaN where not seen.
        layout: what the caller or the format says; None to tell it from the array.
        body: whose proportions decide.
        name: of the file, for messages.

    Raises:
        ValueError: when the layout is wrong, or none fits, or two do; names what fits.
    """
    count = positions.shape[1]
    misfits = {one: _misfit(positions, one, body) for one in LAYOUTS if _counts(one, count)}
    fitting = [one for one, misfit in misfits.items() if misfit <= GOOD]
    if layout is not None:
        if len(keypoint_names(layout)) != count:
            raise FormatError(
                f"{name}: layout {layout} has {len(keypoint_names(layout))} keypoints, the file "
                f"{count}{_hint(fitting)}"
            )
        if misfits[layout] > GOOD:
            raise FormatError(
                f"{name}: in the layout {layout} the points are no body: bones change their "
                f"lengths or have lengths that no person's have{_hint(fitting)}"
            )
        return layout, f"layout {layout}: given"
    if not misfits:
        raise FormatError(
            f"{name}: {count} points are no layout known here ("
            f"{', '.join(f'{one} {len(names)}' for one, names in LAYOUTS.items())}); write the "
            "names of the points beside them, in a table or .npz"
        )
    if not fitting:
        raise FormatError(
            f"{name}: {count} points may be {' or '.join(misfits)}, but they are a body in none "
            "of these orders; give the right one with --layout, or write the points with names"
        )
    best, *others = sorted(fitting, key=lambda one: misfits[one])
    if others and misfits[best] > _BETTER * misfits[others[0]]:
        raise FormatError(
            f"{name}: {count} points may be {' or '.join((best, *others))}; give --layout"
        )
    which = f"{count} points" if len(misfits) == 1 else f"{count} points, a body only so"
    return best, f"layout {best}: {which}"


def _hint(fitting: list[str]) -> str:
    return f"; {' or '.join(fitting)} fits, give it with --layout" if fitting else ""


def _counts(layout: str, count: int) -> bool:
    return len(LAYOUTS[layout]) == count


def _misfit(positions: np.ndarray, layout: str, body: BodyModel) -> float:
    found = bone_lengths(positions, BodyPoints.of_layout(layout, body), body)
    return np.inf if found is None else found.misfit
