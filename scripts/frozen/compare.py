"""How far two results of one case lie apart, and whether that is too far."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

RISE = 1e-3
"""Share by which an objective may rise."""
LABELS = 0.01
"""Share of labels (contacts, what was visible) that may be others, where joints may move."""
OTHERS = 10.0
"""Tolerance of other numbers, relative where they are above one, in that of joints."""


@dataclass(frozen=True)
class Difference:
    """Two results of one case."""

    joints: str
    """Largest distance along an axis, millimetres; empty where the case has no joints."""
    objective: str
    """Relative change."""
    words: tuple[str, ...]
    """What is too far apart; empty where nothing is."""


def differences(old: Path, new: Path, tolerance: float) -> Difference:
    """Compare two files of arrays.

    Args:
        old: the reference.
        new: what is compared with it.
        tolerance: of joints, metres.
    """
    with np.load(old) as a, np.load(new) as b:
        was, now = dict(a), dict(b)
    words: list[str] = []
    joints = objective = ""
    for name in sorted({*was, *now}):
        if name not in was or name not in now:
            words.append(f"{name} is {'new' if name in now else 'gone'}")
        elif was[name].shape != now[name].shape:
            words.append(f"{name}: shape {was[name].shape} became {now[name].shape}")
        elif was[name].dtype.kind in "US":
            words += _lines(was[name], now[name])
        elif name == "objective":
            change = float(now[name] / was[name] - 1)
            objective = f"{100 * change:+.4f} %"
            # also what is no number
            words += [] if change <= RISE else ["the objective rose"]
        else:
            apart = np.abs(now[name].astype(float) - was[name].astype(float))
            apart = np.where(np.isnan(now[name]) & np.isnan(was[name]), 0.0, apart)
            if name == "joints":
                joints = f"{1000 * apart.max():.4f}"
                words += [] if apart.max() <= tolerance else ["joints moved"]
            elif name == "contacts" or was[name].dtype == bool:
                share = (apart > 0.5).mean()
                words += [] if share <= LABELS else [f"{share:.1%} of {name} changed"]
            else:
                most = OTHERS * tolerance * np.maximum(1.0, np.nan_to_num(np.abs(was[name])))
                if not (apart <= most).all():
                    words.append(f"{name} moved by up to {apart.max():.4g}")
    return Difference(joints, objective, tuple(words))


def _lines(was: np.ndarray, now: np.ndarray) -> list[str]:
    """The first words that are others."""
    other = np.atleast_1d(was != now).nonzero()[0]
    if len(other) == 0:
        return []
    a, b = np.atleast_1d(was)[other[0]], np.atleast_1d(now)[other[0]]
    k = next((k for k, pair in enumerate(zip(a, b, strict=False)) if pair[0] != pair[1]), 0)
    k = max(k - 20, 0)
    return [f"{len(other)} texts changed, first {a[k : k + 60]!r} to {b[k : k + 60]!r}"]
