"""Tables of depth from the windows that `benchmarks.clouds` fitted.

    python -m benchmarks.depth clouds.json clouds_people.json clouds_mixed.json --out FOLDER

A window that several files have is taken from the first. Windows whose files were refused are left
out. `depth-warned` counts fits of clouds that are more than 10 cm off and say nothing, and right
ones that warn.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.cloud_cases import ALONE, OTHERS
from benchmarks.protocol import Cell, Metrics, Table, columns_of, number, parser, spread
from recon.metrics.intervals import Interval, interval, paired

NAMES = {
    "depth": "depth, sensor known", OTHERS: "depth, sensor known, MakeHuman's people",
    "depth, sensor unknown": "depth, sensor unknown", "2D": "2D of the sensor, unknown",
    "2D + depth": "2D + depth, sensor unknown", "joints": "joints",
    "joints + depth": "joints + depth, sensor known",
}  # fmt: skip
COLUMNS: Metrics = {
    "root_visible": ("visible cm", 100, 1), "root_hidden": ("hidden cm", 100, 1),
    "root_all": ("all cm", 100, 1), "vertices_visible": ("vertices seen cm", 100, 1),
    "vertices": ("vertices cm", 100, 1), "surface": ("surface cm", 100, 1),
    "covered_visible": ("within std, seen", 1, 2), "covered_hidden": ("hidden", 1, 2),
    "wrong": ("windows wrong %", 100, 0), "first": ("first guess cm", 100, 1),
    "normal": ("normal °", 1, 1), "height": ("height cm", 100, 1),
    "first_seconds": ("first CPU s", 1, 1), "seconds": ("CPU s", 1, 1),
}  # fmt: skip
ERRORS = ("root_visible", "root_hidden", "root_all", "vertices_visible", "vertices")
METHOD, TURNED = "recon", "turned"
WRONG = 0.1
"""Mean error of joints about the pelvis, metres, from which on a fit should say something."""

Values = Mapping[str, Mapping[str, Any]]
"""Metrics by window."""


@dataclass(frozen=True)
class Found:
    """Windows by case and method, and whose they are."""

    subject: Mapping[str, str]
    apart: Sequence[str]
    cases: Mapping[str, Mapping[str, Values]]

    @classmethod
    def read(cls, files: Sequence[Mapping[str, Any]]) -> "Found":
        """Files of `benchmarks.clouds` as one."""
        subject: dict[str, str] = {}
        cases: dict[str, dict[str, dict[str, Any]]] = {case: {} for case in NAMES}
        for file in reversed(files):
            subject |= dict(zip(file["names"], file["subjects"], strict=True))
            for case, methods in file["values"].items():
                for method, windows in methods.items():
                    kept = {k: row for k, row in windows.items() if "refused" not in row}
                    cases[case].setdefault(method, {}).update(kept)
        return cls(subject, files[0]["apart"], {c: own for c, own in cases.items() if own})

    def mean(self, own: Values, metric: str, less: Values | None = None) -> Interval | None:
        """The mean over subjects who count, or that of differences on the same windows."""
        names = [name for name in own if self.subject[name] not in self.apart
                 and (less is None or name in less)]  # fmt: skip
        values = [own[name].get(metric) for name in names]
        if all(value is None for value in values):
            return None
        groups = ([n.rsplit("@", 1)[0] for n in names], [self.subject[n] for n in names])
        if less is None:
            return interval(values, *groups)
        return paired(values, [less[name].get(metric) for name in names], *groups)


def main() -> None:
    """Read, average and write."""
    arguments = parser(__doc__)
    arguments.add_argument("files", type=Path, nargs="+", help="that benchmarks.clouds wrote")
    given = arguments.parse_args()
    files = [json.loads(path.read_text(encoding="utf-8")) for path in given.files]
    about = [file["about"] for file in files]
    for name, table in tables(Found.read(files)).items():
        done = Table(table.columns, table.rows, about)
        print(f"\n{name}\n\n{done.markdown()}")
        if given.out is not None:
            done.write(given.out / f"{name}.json")


def tables(found: Found) -> dict[str, Table]:
    """Means, means by subject, paired differences, and warnings."""
    usual = {case: own[METHOD] for case, own in found.cases.items() if METHOD in own}
    means: list[list[Cell]] = []
    people = sorted(set(found.subject.values()))
    single: list[list[Cell]] = []
    for case, own in usual.items():
        every = [found.mean(own, metric) for metric in COLUMNS]
        means.append([NAMES[case], len(own), *(
            None if one is None else number(one.mean, factor)
            for one, (_, factor, _) in zip(every, COLUMNS.values(), strict=True)
        )])  # fmt: skip
        by_person = [[v["root_all"] for n, v in own.items() if found.subject[n] == p]
                     for p in people]  # fmt: skip
        single.append([NAMES[case], *(number(sum(v) / len(v) if v else None, 100)
                                      for v in by_person)])  # fmt: skip
    differences: list[list[Cell]] = [
        [f"{NAMES[case]}: less {NAMES[part]}",
         *(spread(found.mean(own, metric, usual[part]), 100) for metric in ERRORS)]
        for case, own in usual.items()
        for part in ALONE.get(case, ()) if part in usual
    ]  # fmt: skip
    heads = [(COLUMNS[metric][0].removesuffix(" cm"), 1) for metric in ERRORS]
    first, *rest = columns_of("case", COLUMNS)
    return {
        "depth": Table([first, ("windows", 0), *rest], means),
        "depth-by-subject": Table([("all joints, cm", None), *((p, 1) for p in people)], single),
        "depth-compared": Table([("cm, with 95 % intervals", None), *heads], differences),
        "depth-warned": Table(
            [("fits", None), ("more than 10 cm off", 0), ("of them silent", 0), ("others", 0),
             ("of them with a warning", 0)],
            [_warned(found, METHOD, "all"), _warned(found, TURNED, "begun turned round")],
        ),
    }  # fmt: skip


def _warned(found: Found, method: str, label: str) -> list[Cell]:
    """All fits of clouds of a method."""
    every = [one for case, own in found.cases.items() if "depth" in case
             for one in own.get(method, {}).values()]  # fmt: skip
    far = [bool(one["said"]) for one in every if one["root_all"] > WRONG]
    near = [bool(one["said"]) for one in every if one["root_all"] <= WRONG]
    return [label, len(far), far.count(False), len(near), near.count(True)]


if __name__ == "__main__":
    main()
