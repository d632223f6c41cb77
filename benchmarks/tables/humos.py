"""HUMOS judged alone: its network, whose motion it makes, and what it brings to fits."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.strangers.compare import FEWEST
from benchmarks.tables.values import NONE, markdown, number, present, result, source, spread
from recon.benchmark.table import Interval, interval, paired

Rows = Sequence[Mapping[str, Any]]
Found = Mapping[str, Any]
"""What a result file has of one study."""

FILE = "bodies"
_LATER = "*To be measured: `python -m benchmarks.bodies CORPUS KEPT --json bodies.json`.*"
_METRICS: Mapping[str, tuple[str, float, int]] = {
    "penetrate": ("penetrate cm", 100, 2), "float": ("float cm", 100, 2),
    "dynamic_stability": ("dyn. stability %", 100, 1),
    "stability_supported": ("stable, corrected %", 100, 1),
    "bos_distance_supported": ("BoS dist, corrected cm", 100, 1),
    "slip_in_contact": ("slip m/s", 1, 3), "contacts": ("contacts %", 100, 1),
    "trembling": ("jerk / copy's", 1, 2),
}  # fmt: skip
_LABELS = {
    "truth": "truth, its own body", "copy": "copy", "scaled copy": "scaled copy",
    "physics": "scaled copy, settled (physics alone)", "network": "network",
    "network, settled": "network, settled",
}  # fmt: skip
_COMPARED = (
    ("network", "scaled copy"),
    ("network", "physics"),
    ("network, settled", "physics"),
)
_STATISTICS: Mapping[str, tuple[str, int]] = {
    "cadence": ("cadence", 1), "step": ("step length / leg length", 1),
    "speed": ("speed / leg length", 1), "sway": ("sway of the pelvis / leg length", 1),
    "arms": ("arm swing", 1),
}  # fmt: skip


def network() -> str:
    """Means over subjects by method."""
    return _measured("network", network_lines)


def network_lines(found: Found) -> str:
    """Every method's means over subjects of means over clips without flight."""
    rows = [row for row in found["rows"] if not row["flies"]]
    apart = set(found["apart"])
    methods: list[str] = list(dict.fromkeys(row["method"] for row in rows))
    lines: list[list[str]] = []
    for method in methods:
        own = [r for r in rows if r["method"] == method and r["subject"] not in apart]
        cells = [_estimated(own, key, f, d) for key, (_, f, d) in _METRICS.items()]
        lines.append([_LABELS.get(str(method), str(method)), *cells])
    clips = {(row["clip"], row["subject"]) for row in rows}
    people = sorted({subject for _, subject in clips})
    head = f"{len(clips)} clips of {', '.join(people)}"
    return markdown([head, *(h for h, _, _ in _METRICS.values())], lines)


def network_paired() -> str:
    """Differences of methods clip by clip."""
    return _measured("network", network_differences)


def network_differences(found: Found) -> str:
    """First method minus second on the same clips and bodies, with 95 % intervals."""
    rows = [r for r in found["rows"] if not r["flies"] and r["subject"] not in found["apart"]]
    named = dict.fromkeys(str(row["method"]) for row in rows)
    compared = [*_COMPARED]
    compared += [(m, m.split(": ", 1)[1]) for m in named if ": " in m]
    groups: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
        "all bodies": lambda _: True,
        "bodies of people": lambda row: bool(row["real"]),
        "bodies drawn": lambda row: not row["real"],
    }
    lines = [
        [f"{first} − {second}, {group}",
         *(_difference([r for r in rows if belongs(r)], first, second, key, f, d)
           for key, (_, f, d) in _METRICS.items())]
        for first, second in compared
        for group, belongs in groups.items()
    ]  # fmt: skip
    return markdown(["difference", *(h for h, _, _ in _METRICS.values())], lines)


def whose() -> str:
    """Distances of A's walk on B's body from B's own walks, and from A's."""
    return _measured("whose", whose_lines)


def whose_lines(found: Found) -> str:
    """Distances in standard deviations of one person's walks, and paired differences."""
    rows, units = found["rows"], found["spreads"]
    methods = [m for m in dict.fromkeys(r["method"] for r in rows) if m != "scaled copy"]
    lines: list[list[str]] = []
    groups: list[tuple[str, Rows]] = [("", rows)]
    strangers = [r for r in rows if r["body"] not in found["learned"]]
    if 0 < len(strangers) < len(rows):
        groups.append((", bodies never learned from", strangers))
    for name, some in groups:
        keys: list[tuple[str, tuple[str, ...]]] = (
            [(label, (key,)) for key, (label, _) in _STATISTICS.items()] if name == "" else []
        )
        for label, own in [*keys, (f"**mean of all{name}**", tuple(_STATISTICS))]:
            lines.append([label, *_whose_cells(some, own, units, methods, found["recorded"])])
    people = ", ".join(found["recorded"])
    return markdown(
        [f"walks of {people}", "B's other walks", "A's own walk", "scaled copy",
         *(f"{m}" for m in methods), *(f"{m} − scaled copy" for m in methods),
         *(f"{m}: way from the copy to B, %" for m in methods)],
        lines,
    )  # fmt: skip


def _whose_cells(
    rows: Rows,
    keys: tuple[str, ...],
    units: Mapping[str, float],
    methods: Sequence[str],
    recorded: Mapping[str, Sequence[Mapping[str, float]]],
) -> list[str]:
    by_method = {m: [r for r in rows if r["method"] == m] for m in ("scaled copy", *methods)}
    copies = by_method["scaled copy"]
    clips = [row["clip"] for row in copies]
    pairs = [f"{row['person']} as {row['body']}" for row in copies]
    bodies = sorted({row["body"] for row in rows})

    def away(some: Rows, of: str = "made") -> list[float | None]:
        return [_distance(row[of], row["other"], keys, units) for row in some]

    itself = [_distance(one, _mean_without(recorded[b], k), keys, units)
              for b in bodies for k, one in enumerate(recorded[b])]  # fmt: skip
    known = [value for value in itself if value is not None]
    cells = [number(float(np.mean(known)), 1, 2) if known else NONE]
    apart = [away(copies, "own"), *(away(by_method[m]) for m in by_method)]
    cells += [_spread_of(values, clips, pairs) for values in apart]
    more = [_less(away(by_method[m]), away(copies)) for m in methods]
    cells += [_spread_of(values, clips, pairs) for values in more]
    return cells + [_way(by_method[m], copies, keys, units) for m in methods]


def _less(values: Sequence[float | None], others: Sequence[float | None]) -> list[float | None]:
    """Differences where both are known."""
    pairs = zip(values, others, strict=True)
    return [None if a is None or b is None else a - b for a, b in pairs]


def _spread_of(values: Sequence[float | None], clips: Sequence[str], pairs: Sequence[str]) -> str:
    """A mean with its interval; nothing where no walk has steps to measure."""
    if all(value is None for value in values):
        return NONE
    return spread(interval(values, clips, pairs))


def _distance(
    a: Mapping[str, float] | None,
    b: Mapping[str, float],
    keys: tuple[str, ...],
    units: Mapping[str, float],
) -> float | None:
    return None if a is None else float(np.mean([abs(a[k] - b[k]) / units[k] for k in keys]))


def _mean_without(walks: Sequence[Mapping[str, float]], left: int) -> dict[str, float]:
    others = [walk for k, walk in enumerate(walks) if k != left]
    return {key: float(np.mean([walk[key] for walk in others])) for key in walks[0]}


def _way(rows: Rows, copies: Rows, keys: tuple[str, ...], units: Mapping[str, float]) -> str:
    """How far a method goes from the copy towards B: least squares over walks and statistics."""
    moved, whole = 0.0, 0.0
    for row, copy in zip(rows, copies, strict=True):
        if row["made"] is None or copy["made"] is None:
            continue
        for key in keys:
            to_other = (row["other"][key] - copy["made"][key]) / units[key]
            moved += to_other * (row["made"][key] - copy["made"][key]) / units[key]
            whole += to_other**2
    return number(moved / whole, 100, 1) if whole > 0 else NONE


def people_noisy() -> str:
    """Fits of noisy joints person by person."""
    return _measured("prior", lambda found: people_lines(found, "noisy joints"))


def people_hidden() -> str:
    """Fits of hidden points person by person."""
    return _measured("prior", lambda found: people_lines(found, "hidden points"))


def people_lines(found: Found, protocol: str) -> str:
    """Errors and slip of three fits for everybody, with paired differences."""
    rows = [row for row in found["rows"] if row["protocol"] == protocol]
    lines: list[list[str]] = []
    people = sorted({row["subject"] for row in rows})
    counted = [person for person in people if person not in found["apart"]]
    for person, those in [*((p, [p]) for p in people), ("**mean over people**", counted)]:
        own = [row for row in rows if row["subject"] in those]
        label = f"{person}, {len({r['window'] for r in own})} windows"
        cells: list[str] = []
        for key in ("error", "slip"):
            means = [_mean(own, method, key) for method in ("stages 1-2", "physics", "humos")]
            cells.append(", ".join(number(mean, 100, 2) for mean in means))
            cells += [_person_difference(own, "humos", m, key) for m in ("stages 1-2", "physics")]
        lines.append([label, *cells])
    three = "stages 1-2, physics, HUMOS"
    return markdown(
        [protocol, f"cm: {three}", "HUMOS − stages 1-2", "HUMOS − physics",
         f"slip cm/s: {three}", "HUMOS − stages 1-2", "HUMOS − physics"],
        lines,
    )  # fmt: skip


def _mean(rows: Rows, method: str, key: str) -> float | None:
    """Mean over people of means over windows."""
    by_person: dict[str, list[float]] = {}
    for row in rows:
        if row["method"] == method and row[key] is not None:
            by_person.setdefault(row["subject"], []).append(row[key])
    return float(np.mean([np.mean(own) for own in by_person.values()])) if by_person else None


def _person_difference(rows: Rows, first: str, second: str, key: str) -> str:
    """Paired differences; where a person has few clips, intervals draw windows."""
    by_window = {
        method: {row["window"]: row for row in rows if row["method"] == method}
        for method in (first, second)
    }
    clips: dict[str, set[str]] = {}
    for row in rows:
        clips.setdefault(row["subject"], set()).add(row["clip"])
    pairs = [(row, by_window[second][name]) for name, row in by_window[first].items()]
    if not any(a[key] is not None and b[key] is not None for a, b in pairs):
        return NONE
    units = [a["clip"] if len(clips[a["subject"]]) >= FEWEST else a["window"] for a, _ in pairs]
    found = paired([a[key] for a, _ in pairs], [b[key] for _, b in pairs], units,
                   [a["subject"] for a, _ in pairs])  # fmt: skip
    return _marked(found, 100, 2)


def _estimated(rows: Rows, key: str, factor: float, digits: int) -> str:
    if all(row[key] is None for row in rows):
        return NONE
    values, clips, subjects = zip(*((r[key], r["clip"], r["subject"]) for r in rows), strict=True)
    return number(interval(values, clips, subjects).mean, factor, digits)


def _difference(rows: Rows, first: str, second: str, key: str, factor: float, digits: int) -> str:
    a, b = ({r["clip"]: r for r in rows if r["method"] == m} for m in (first, second))
    if not any(a[c][key] is not None and b[c][key] is not None for c in a):
        return NONE
    clips = list(a)
    found = paired([a[c][key] for c in clips], [b[c][key] for c in clips], clips,
                   [a[c]["subject"] for c in clips])  # fmt: skip
    return _marked(found, factor, digits)


def _marked(found: Interval, factor: float, digits: int) -> str:
    """A difference and its interval, in bold where zero lies outside."""
    cell = spread(found, factor, digits)
    return f"**{cell}**" if found.sure else cell


def _measured(study: str, table: Callable[[Found], str]) -> str:
    """A table of a study that the result file has."""
    if not present([FILE]) or study not in result(FILE):
        return _LATER
    return f"{table(result(FILE)[study])}{source(FILE)}"


BY_STUDY: Mapping[str, Mapping[str, Callable[[Found], str]]] = {
    "network": {"means over subjects": network_lines, "paired": network_differences},
    "whose": {"distances in standard deviations of a person's walks": whose_lines},
    "prior": {
        "noisy joints": lambda found: people_lines(found, "noisy joints"),
        "hidden points": lambda found: people_lines(found, "hidden points"),
    },
}
"""Tables of every study, for the terminal."""
