"""Assigns the detections of a frame to people."""

import numpy as np
from jaxtyping import Float

BEGINS = 25.0
"""Cost of somebody new; more than that of any link that is allowed."""
_ALTERNATIVES = 8.0
"""Other assignments of a frame are followed while they cost at most so much more."""


def cheapest_assignments(
    costs: Float[np.ndarray, "people rows"],
) -> list[dict[int, int]]:
    """Return the assignment of people to detections of least cost, then others about as good."""
    from scipy.optimize import linear_sum_assignment

    allowed = np.isfinite(costs)
    gain = np.where(allowed, costs - 2 * BEGINS, 0.0)
    best = {
        int(k): int(p) for k, p in zip(*linear_sum_assignment(gain), strict=True) if allowed[k, p]
    }
    out = [best]
    owner = {p: k for k, p in best.items()}
    for k, p in best.items():
        for other in np.flatnonzero(allowed[:, p]).tolist():
            if other == k:
                continue
            if other not in best:
                more = costs[other, p] - costs[k, p]
                changed = {one: place for one, place in best.items() if one != k} | {other: p}
            elif other > k and allowed[k, best[other]]:
                theirs = best[other]
                more = costs[k, theirs] + costs[other, p] - costs[k, p] - costs[other, theirs]
                changed = best | {k: theirs, other: p}
            else:
                continue
            if more < _ALTERNATIVES:
                out.append(changed)
        for place in np.flatnonzero(allowed[k]).tolist():
            more = costs[k, place] - costs[k, p]
            if place not in owner and more < _ALTERNATIVES:
                out.append(best | {k: place})
    return out
