"""Finds pairs of markers whose labels are exchanged, from some frame on or throughout.

Exchanged labels show in two ways: two markers jump to each other's positions from one frame to
the next, and each lies where the body has the other one.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.mocap.recording import MarkerRecording

_APART = 0.04
"""Distance (m) between two markers below which exchanging them changes little."""
_NEARER = 0.35
"""Largest distance of markers from each other's last positions, over that from their own, at
which their labels count as exchanged."""
_MISPLACED = 0.08
"""Distance (m) of a marker from its fitted position beyond which it may be another marker."""
_BETTER = 0.5
"""Largest distance of two markers from fitted positions after an exchange, over that before it."""


def with_exchanges_undone(recording: MarkerRecording) -> tuple[MarkerRecording, list[Finding]]:
    """Correct labels that are exchanged in some frames; return the recording, and findings.

    Exchanges of a pair divide the recording into parts, every second of which is wrong: those
    that together have fewer frames.
    """
    positions, visible = recording.positions.copy(), recording.visible.copy()
    wrong: dict[tuple[int, int], Bool[np.ndarray, " time"]] = {}
    for a, b in _pairs_that_jump(recording):
        flips = _frames_of_exchange(positions[:, [a, b]], visible[:, [a, b]])
        if not flips.any() or flips.sum() > max(2, len(flips) // 8):
            continue
        odd = np.cumsum(flips) % 2 == 1
        odd = ~odd if odd.mean() > 0.5 else odd
        wrong[a, b] = odd
        for values in (positions, visible):
            values[np.ix_(odd, [a, b])] = values[np.ix_(odd, [b, a])]
    if not wrong:
        return recording, []
    repaired = dataclasses.replace(recording, positions=positions, visible=visible)
    return repaired, _stretch_findings(recording.marker_names, wrong)


def _pairs_that_jump(recording: MarkerRecording) -> list[tuple[int, int]]:
    """Return pairs of markers that both move far between the same two frames."""
    both = recording.visible[1:] & recording.visible[:-1]
    steps = np.linalg.norm(np.diff(recording.positions, axis=0), axis=-1) * both
    jumps = steps > _APART
    together = jumps.astype(np.float32).T @ jumps.astype(np.float32)
    count = len(recording.marker_names)
    return [(a, b) for a in range(count) for b in range(a + 1, count) if together[a, b] > 0]


def _frames_of_exchange(
    x: Float[np.ndarray, "time 2 3"], visible: Bool[np.ndarray, "time 2"]
) -> Bool[np.ndarray, " time"]:
    """Return a mask of frames at which two markers jump to each other's last position."""
    seen = np.all(visible, axis=1)
    seen = np.concatenate(([False], seen[1:] & seen[:-1]))
    before = np.concatenate((x[:1], x[:-1]))
    same = np.linalg.norm(x - before, axis=-1)
    other = np.linalg.norm(x[:, ::-1] - before, axis=-1)
    return seen & (same.min(1) > _APART) & (other.max(1) < _NEARER * same.min(1))


def _stretch_findings(
    labels: Sequence[str], wrong: dict[tuple[int, int], Bool[np.ndarray, " time"]]
) -> list[Finding]:
    """Make findings about exchanged labels, one for all pairs exchanged in the same frames."""
    groups: dict[bytes, list[tuple[int, int]]] = {}
    for pair, odd in wrong.items():
        groups.setdefault(odd.tobytes(), []).append(pair)
    found: list[Finding] = []
    for pairs in groups.values():
        frames = stretches(wrong[pairs[0]])
        names = tuple(labels[k] for pair in pairs for k in pair)
        sides = len(pairs) > 1 and all(opposite_label(labels[a]) == labels[b] for a, b in pairs)
        what = " and ".join(f"{labels[a]} with {labels[b]}" for a, b in pairs[:3])
        more = f" and {len(pairs) - 3} pairs more" if len(pairs) > 3 else ""
        found.append(
            Finding(
                "sides exchanged" if sides else "points exchanged",
                f"markers jump to each other's places and back in {spans(frames)}: {what}{more}; "
                "their labels were exchanged there",
                names,
                frames,
                float(wrong[pairs[0]].mean()),
            )
        )
    return found


def pairs_exchanged_throughout(
    labels: Sequence[str],
    positions: Float[np.ndarray, "time markers 3"],
    visible: Bool[np.ndarray, "time markers"],
    fitted_positions: Float[np.ndarray, "time markers 3"],
) -> list[tuple[int, int]]:
    """Find pairs of markers that lie at each other's position on the body in all frames.

    Args:
        labels: names of the markers.
        positions: observed positions of the markers, metres.
        visible: whether each marker is seen.
        fitted_positions: of the landmarks that the labels name, on the fitted body, metres.
    """
    count = len(labels)
    away = np.full((count, count), np.nan)
    for a in range(count):
        seen = visible[:, a]
        if seen.any():
            there = positions[seen, a][:, None] - fitted_positions[seen]
            away[a] = np.median(np.linalg.norm(there, axis=-1), axis=0)
    own = np.diag(away)
    pairs = [
        (away[a, b] + away[b, a] - own[a] - own[b], a, b)
        for a in range(count)
        for b in range(a + 1, count)
        if min(own[a], own[b]) > _MISPLACED
        and away[a, b] + away[b, a] < _BETTER * (own[a] + own[b])
    ]
    chosen: list[tuple[int, int]] = []
    for _, a, b in sorted(pairs):
        if not any(k in pair for pair in chosen for k in (a, b)):
            chosen.append((a, b))
    return chosen


def with_labels_exchanged(
    recording: MarkerRecording, pairs: Sequence[tuple[int, int]]
) -> MarkerRecording:
    """Return the recording with the labels of given pairs of markers exchanged."""
    order = list(range(len(recording.marker_names)))
    for a, b in pairs:
        order[a], order[b] = b, a
    return dataclasses.replace(
        recording, positions=recording.positions[:, order], visible=recording.visible[:, order]
    )


def side_pairs(labels: Sequence[str]) -> list[tuple[int, int]]:
    """Return pairs of labels (indices) that are each other's counterpart on the other side."""
    return [
        (k, labels.index(other))
        for k, label in enumerate(labels)
        if (other := opposite_label(label)) in labels and k < labels.index(other)
    ]


_SIDES = {
    one: other
    for left, right in (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"))
    for one, other in ((left, right), (right, left))
}
_LETTERS = {"l": "r", "r": "l", "L": "R", "R": "L"}


def opposite_label(label: str) -> str | None:
    """Return a label's counterpart on the other side, LASI -> RASI; None if it names no side."""
    for one, other in _SIDES.items():
        if one in label:
            return label.replace(one, other, 1)
    if label[:1] in _LETTERS:
        return _LETTERS[label[0]] + label[1:]
    if label[-1:] in _LETTERS and not label[-2:-1].islower():
        return label[:-1] + _LETTERS[label[-1]]
    return None


def pair_finding(labels: Sequence[str], pairs: Sequence[tuple[int, int]]) -> Finding:
    """Make the finding that the labels of some pairs of markers were exchanged in all frames."""
    names = tuple(labels[k] for pair in pairs for k in pair)
    what = listed([f"{labels[a]} with {labels[b]}" for a, b in pairs])
    return Finding(
        "points exchanged",
        f"markers lie in each other's place on the body throughout: {what}; their labels were "
        "exchanged",
        names,
        value=float(len(pairs)),
    )
