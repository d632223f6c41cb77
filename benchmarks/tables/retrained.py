"""Fits by one weights or method beside fits by others, on the same windows and recordings."""

from collections.abc import Sequence
from typing import Any

from benchmarks.real import HUMOR
from benchmarks.tables.real import ROWS, mean_over_people
from benchmarks.tables.values import markdown, number, result, source, spread

_NOISY = ("noisy joints", "joints_all", "noisy joints")
_HIDDEN = ("occluded points", "observed_hidden", "hidden points")
_ALL = ("occluded points", "observed_all", "all points")
_Told = tuple[str, str, str]
_Names = tuple[str, ...]

_WEIGHTS: Sequence[tuple[_Names, _Told]] = (
    (("humor_former", "humor_anew", "humor"), _NOISY),
    (("humor_hidden_states", "humor_hidden_anew", "humor_hidden"), _HIDDEN),
)
_STEPS = ("humor_hidden_before", "humor_hidden_limbs", "humor_hidden_carried",
          "humor_hidden_states")  # fmt: skip
_LIMBS: Sequence[tuple[_Names, _Told]] = ((_STEPS, _HIDDEN), (_STEPS, _ALL))


def weights() -> str:
    """Errors of the default method with the open weights of 0.1.0, and on the way to today's."""
    headings = ("weights of 0.1.0", "trained anew", "today")
    return _beside(_WEIGHTS, ("real_states", "real_anew", "real"), headings)


def limbs() -> str:
    """Errors without the search for limbs that nobody saw, and with each step towards today's."""
    headings = ("without", "with particles", "and feet that carry", "and likely states")
    return _beside(_LIMBS, ("real_before", "real_limbs", "real_carried", "real_states"), headings)


def licences() -> str:
    """Hidden markers of people whom neither the open nor the nc weights know."""
    return _beside((), ("real", "real_nc"), ("open", "nc"))


def _beside(measured: Sequence[tuple[_Names, _Told]], real: _Names, headings: _Names) -> str:
    rows: list[list[str]] = []
    for names, (protocol, metric, told) in measured:
        every = [_of(name, protocol) for name in names]
        for subject in ("mean", *sorted(set(every[0]) - {"mean", "windows"})):
            cells = [number(row[subject][metric], 100, 2) for row in every]
            rows.append([f"test, {told}, {subject}", *cells])
    found = [list(result(name)["recordings"].values()) for name in real]
    for kind in ROWS:
        some = [[row for row in own if row["row"] == kind] for own in found]
        cells = [spread(mean_over_people(own, HUMOR), 1, 1) for own in some]
        rows.append([f"recordings, {kind}, markers below 0.9 m hidden", *cells])
    names = dict.fromkeys([*(name for own, _ in measured for name in own), *real])
    return markdown(["cm", *headings], rows) + source(*names)


def _of(name: str, protocol: str) -> dict[str, Any]:
    return result(name)["tables"]["60 frames"][protocol]["HuMoR"]
