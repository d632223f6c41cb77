"""Measures fits to noisy joints, hidden points, gaps and upper bodies, as `recon bench` does.

    python -m benchmarks.humor CORPUS --out FOLDER
    python -m benchmarks.humor CORPUS --part validation --only 6

The protocols are those of `recon.bench` (docs/bench.md) on all listed windows, including people
whose recordings are not free for commercial use. Smoothers and the pose prior are compared with
collocation under HuMoR; the table `compared` has the difference of the last two window by window,
and `kinds` groups the windows by the action that the description of each recording names.
"""

from collections.abc import Mapping, Sequence

import recon
from benchmarks.protocol import (
    Cell,
    Metrics,
    Table,
    columns_of,
    number,
    over_windows,
    spread,
    tell_of,
)
from recon.benchmark.dataset import clip_files
from recon.benchmark.methods import BenchMethod, method_named
from recon.benchmark.table import BenchTable, mean_with_interval, paired_difference
from training.humor.corpus import OTHER, described_action, kind_of_motion

PROTOCOLS = {
    "noisy-joints": "noisy-joints",
    "hidden-points": "hidden-points",
    "in-betweening": "gap",
    "upper-body": "upper-body",
}
"""Protocols of `recon.bench`, by the names of the tables."""
SMOOTHERS = {"butterworth": "Butterworth, 2 Hz", "least-squares": "penalised least squares"}
POSE, HUMOR = "stages 1-2 (`--prior pose`)", "**collocation, HuMoR (the default)**"
COLUMNS: Mapping[str, Metrics] = {
    "noisy-joints": {
        "joints_all": ("joints cm", 100, 2), "joints_legs": ("legs cm", 100, 2),
        "accel_error": ("accel. error m/s²", 1, 2), "penetration_freq": ("below ground %", 100, 2),
        "slip_speed": ("slip cm/s", 100, 1), "seconds": ("CPU s per clip", 1, 1),
    },
    "hidden-points": {
        "observed_visible": ("seen cm", 100, 2), "observed_hidden": ("hidden cm", 100, 1),
        "observed_all": ("all points cm", 100, 2), "joints_legs": ("legs cm", 100, 1),
        "vertices": ("vertices cm", 100, 2), "penetration_freq": ("below ground %", 100, 1),
        "seconds": ("CPU s per clip", 1, 1),
    },
}  # fmt: skip
RECIPE: Metrics = {
    "joints_all": ("joints cm", 100, 1), "joints_legs": ("legs cm", 100, 1),
    "accel_error": ("accel. error m/s²", 1, 2), "slip_speed": ("slip cm/s", 100, 1),
}  # fmt: skip
COMPARED = {
    "noisy-joints": {"joints_all": "joints", "joints_legs": "legs", "slip_speed": "slip a second"},
    "hidden-points": {"observed_visible": "seen points", "observed_hidden": "hidden points",
                      "joints_legs": "legs"},
    "in-betweening": {"joints_all": "joints", "joints_legs": "legs"},
    "upper-body": {"joints_all": "joints", "joints_legs": "legs"},
}  # fmt: skip
MAIN = {"noisy-joints": "joints_all", "hidden-points": "observed_hidden"}
"""Metric that represents a protocol in tables by kind of motion."""


def main() -> None:
    """Fit all windows in all protocols, print and write the tables."""
    arguments = over_windows(__doc__)
    arguments.add_argument("--protocols", nargs="+", choices=PROTOCOLS, default=list(PROTOCOLS))
    given = arguments.parse_args()
    body = recon.BodyModel.load()
    found: dict[str, BenchTable] = {}
    for name in given.protocols:
        smoothers = SMOOTHERS if name == "noisy-joints" else {}
        methods: dict[str, BenchMethod] = {
            **{label: method_named(own, body) for own, label in smoothers.items()},
            POSE: method_named("pose", body),
            HUMOR: method_named("collocation", body),
        }
        found[name] = recon.bench(
            PROTOCOLS[name], methods, given.corpus,
            part=given.part, splits=given.splits, only=given.only,
        )  # fmt: skip
    files = clip_files(given.corpus)
    clips = {n.rsplit("@", 1)[0] for own in found.values() for n in own.names}
    tables = {name: means(own, COLUMNS.get(name, RECIPE)) for name, own in found.items()}
    tables |= {"compared": compared(found), "windows": counted(next(iter(found.values())))}
    if MAIN.keys() <= found.keys():
        tables["kinds"] = kinds(found, {clip: described_action(files[clip]) for clip in clips})
    tell_of(given, 0, tables, [files[clip] for clip in clips])


def means(found: BenchTable, metrics: Metrics) -> Table:
    """Build a table of every method's means over subjects, with intervals."""
    rows: list[list[Cell]] = []
    for method, values in found.values.items():
        every = {k: found.mean(method, k) if k in values else None for k in metrics}
        cells = [spread(every[k], factor) for k, (_, factor, _) in metrics.items()]
        rows.append([method, *cells, number(found.feet[method], 100)])
    return Table([*columns_of("method", metrics), ("feet right, balanced %", 1)], rows)


def compared(found: Mapping[str, BenchTable]) -> Table:
    """Build a table of errors of collocation minus those of the pose prior, per window."""
    rows: list[list[Cell]] = []
    for name, own in found.items():
        kept = [i for i, who in enumerate(own.subjects) if who in own.counted]
        clips = [own.names[i].rsplit("@", 1)[0] for i in kept]
        people = [own.subjects[i] for i in kept]
        for metric, words in COMPARED[name].items():
            ours, theirs = ([own.values[m][metric][i] for i in kept] for m in (HUMOR, POSE))
            less = paired_difference(ours, theirs, clips, people)
            verdict = "sure" if less.excludes_zero else "inside noise"
            rows.append([f"{name}: {words}, cm", spread(less, 100), verdict])
    return Table([("collocation less stages 1-2", None), ("difference", 2), ("95 %", None)], rows)


def counted(found: BenchTable) -> Table:
    """Build a table with the number of windows of every subject."""
    people = sorted(set(found.subjects), key=lambda who: (who not in found.counted, who))
    counts = [found.subjects.count(who) for who in people]
    heads = [who if who in found.counted else f"{who}, apart" for who in people]
    return Table([("windows", None), *((head, 0) for head in heads)], [["60 frames", *counts]])


def kinds(found: Mapping[str, BenchTable], told: Mapping[str, str]) -> Table:
    """Build a table of errors by kind of motion, the easiest first, with intervals over clips."""
    names, subjects = found["noisy-joints"].names, found["noisy-joints"].subjects
    clips = [name.rsplit("@", 1)[0] for name in names]
    own = [kind_of_motion(told[clip]) for clip in clips]
    pairs = [(name, method) for name in MAIN for method in (POSE, HUMOR)]
    rows: list[tuple[float, list[Cell]]] = []
    for kind in dict.fromkeys(own):
        some = [i for i, its in enumerate(own) if its == kind]
        groups: tuple[Sequence[str], Sequence[str]] = (
            [clips[i] for i in some], [subjects[i] for i in some],
        )  # fmt: skip
        errors = [
            mean_with_interval([found[n].values[m][MAIN[n]][i] for i in some], *groups)
            for n, m in pairs
        ]
        words = sorted({told[clips[i]].split(",")[0] for i in some}) if kind == OTHER else []
        label = f"{kind}: {'; '.join(words)}" if words else kind
        count = f"{len(some)} of {', '.join(sorted(set(groups[1])))}"
        rows.append((errors[-1].mean, [label, count, *(spread(one, 100) for one in errors)]))
    heads = ["noisy joints cm: pose prior", "collocation", "hidden points cm: pose prior",
             "collocation"]  # fmt: skip
    columns = [("kind of motion", None), ("windows", None), *((head, 1) for head in heads)]
    return Table(columns, [row for _, row in sorted(rows, key=lambda one: one[0])])


if __name__ == "__main__":
    main()
