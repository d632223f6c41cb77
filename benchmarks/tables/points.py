"""Noisy joints, hidden points and recipes: results of `benchmarks.humor`."""

from collections.abc import Mapping
from typing import Any

from benchmarks.tables.values import (
    APART,
    NONE,
    SUBJECTS,
    difference,
    estimated,
    markdown,
    mean,
    number,
    result,
    source,
    spread,
)

NETWORKS = "collocation with HuMoR's networks"
FILES = {
    "humor": "60 frames",
    "humor_hidden": "60 frames",
    "humor_recipes": "60 frames",
    "humor_90": "90 frames",
}
"""Result files, and the length of their windows."""
_NAMES = {
    "observed": "as observed",
    "stages 1-2, published": "stages 1-2, HuMoR's published weights",
    "stages 1-2, tuned": "stages 1-2, tuned (`--prior pose`)",
    "stages 1-2": "stages 1-2, tuned (`--prior pose`)",
    "HuMoR": f"**{NETWORKS}, open weights (the default)**",
    "HuMoR, nc": f"{NETWORKS}, nc weights",
    "linear, slerp": "linear and slerp interpolation",
    "truth": "truth",
}
_OF_TRUTH = ("penetration_freq", "slip_speed", "feet_balanced")
"""Columns that mean something for the truth itself; it has no errors."""
_LATER = "*To be measured: version 0.1.0 kept nothing of this.*"
Columns = Mapping[str, tuple[str, float, int]]
"""Heading, factor and digits of every metric."""

NOISY: Columns = {
    "joints_all": ("joints cm", 100, 2), "joints_legs": ("legs cm", 100, 2),
    "accel_error": ("accel. error m/s²", 1, 2), "penetration_freq": ("below ground %", 100, 2),
    "slip_speed": ("slip cm/s", 100, 1), "feet_balanced": ("feet right, balanced %", 100, 1),
    "seconds": ("CPU s per clip", 1, 1),
}  # fmt: skip
HIDDEN: Columns = {
    "observed_visible": ("seen cm", 100, 2), "observed_hidden": ("hidden cm", 100, 1),
    "observed_all": ("all points cm", 100, 2), "joints_legs": ("legs cm", 100, 1),
    "vertices": ("vertices cm", 100, 2), "penetration_freq": ("below ground %", 100, 1),
    "seconds": ("CPU s per clip", 1, 1),
}  # fmt: skip
RECIPE: Columns = {
    "joints_all": ("joints cm", 100, 1), "joints_legs": ("legs cm", 100, 1),
    "accel_error": ("accel. error m/s²", 1, 2), "slip_speed": ("slip cm/s", 100, 1),
}  # fmt: skip


def protocol(name: str, columns: Columns, file: str = "humor") -> str:
    """Every method of one protocol, means with intervals."""
    frames = FILES[file]
    about, tables = result(file)["windows"][frames], result(file)["tables"][frames]
    if name not in tables:
        return _LATER
    found = tables[name]
    rows = [
        [_name(method), *(_cell(row, about, metric, columns) for metric in columns)]
        if method != "truth"
        else [
            method,
            *(_cell(row, about, m, columns) if m in _OF_TRUTH else NONE for m in columns),
        ]
        for method, row in found.items()
        if "shooting" not in method and "contact" not in method
    ]
    headings = [heading for heading, _, _ in columns.values()]
    return markdown(["method", *headings], rows) + source(file)


def noisy() -> str:
    return protocol("noisy joints", NOISY)


def hidden() -> str:
    return protocol("occluded points", HIDDEN, "humor_hidden")


def gap() -> str:
    return protocol("in-betweening", RECIPE, "humor_recipes")


def upper() -> str:
    return protocol("upper body", RECIPE, "humor_recipes")


def noisy_90() -> str:
    return protocol("noisy joints", NOISY, "humor_90")


def hidden_90() -> str:
    return protocol("occluded points", HIDDEN, "humor_90")


def by_subject() -> str:
    """The main column of both protocols, for each person; 16 stands beside the mean."""
    rows = []
    for file, name, metric in (
        ("humor", "noisy joints", "joints_all"),
        ("humor_hidden", "occluded points", "observed_hidden"),
    ):
        for method, row in result(file)["tables"]["60 frames"][name].items():
            cells = [row[s].get(metric) if s in row else None for s in (*SUBJECTS, APART)]
            if cells[0] is None or "shooting" in method or method == "truth":
                continue
            rows.append(
                [f"{name}: {_plain(method)}", *(number(c, 100, 2) for c in cells[:3]),
                 number(mean(row, metric), 100, 2), number(cells[3], 100, 2)]
            )  # fmt: skip
    headings = ["cm (joints; hidden points)", *SUBJECTS, "mean", "16, apart"]
    return markdown(headings, rows) + source("humor", "humor_hidden")


def compared() -> str:
    """Collocation less stages 1-2, window by window."""
    metrics = {
        "noisy joints": ("joints_all", "joints_legs", "slip_speed"),
        "occluded points": ("observed_visible", "observed_hidden", "joints_legs"),
        "in-betweening": ("joints_all", "joints_legs"),
        "upper body": ("joints_all", "joints_legs"),
    }
    words = {
        "joints_all": "joints, cm", "joints_legs": "legs, cm", "slip_speed": "slip, cm/s",
        "observed_visible": "seen points, cm", "observed_hidden": "hidden points, cm",
    }  # fmt: skip
    rows: list[list[str]] = []
    named: list[str] = []
    for file, frames in FILES.items():
        loaded = result(file)
        if "commit" not in loaded["about"]:
            continue  # it kept no values of single windows
        about, tables = loaded["windows"][frames], loaded["tables"][frames]
        named.append(file)
        for name, keys in metrics.items():
            found = tables.get(name, {})
            pose = found.get("stages 1-2, tuned", found.get("stages 1-2"))
            if pose is None or "windows" not in pose:
                continue
            for key in keys:
                made = difference(found["HuMoR"], pose, about, key)
                verdict = "sure" if made.sure else "inside noise"
                rows.append([f"{name}, {frames}: {words[key]}", spread(made, 100, 2), verdict])
    if not rows:
        return _LATER
    return markdown(["collocation less stages 1-2", "difference", "95 %"], rows) + source(*named)


def shooting() -> str:
    """Shooting and the others on the few windows that it was run on."""
    rows: list[list[str]] = []
    named: list[str] = []
    for file, name, keys in (
        ("humor", "noisy joints", ("joints_all", "joints_legs", "slip_speed")),
        ("humor_hidden", "occluded points", ("observed_all", "observed_hidden", "slip_speed")),
    ):
        loaded = result(file)
        if "commit" not in loaded["about"]:
            continue  # it kept no values of single windows
        about, found = loaded["windows"]["60 frames"], loaded["tables"]["60 frames"][name]
        rolled = next((row for method, row in found.items() if "shooting" in method), None)
        if rolled is None:
            continue
        named.append(file)
        chosen = rolled["windows"]["names"]
        for label, row in (
            ("stages 1-2, tuned", found["stages 1-2, tuned"]),
            ("shooting", rolled),
            (NETWORKS, found["HuMoR"]),
        ):
            some = _only(row, about["names"], chosen)
            made = [estimated(some, about, key) for key in keys]
            cells = [NONE if e is None else spread(e, 100, 2) for e in made]
            rows.append([f"{name}: {label}", *cells])
        ours = _only(found["HuMoR"], about["names"], chosen)
        made = [difference(ours, rolled, about, key) for key in keys]
        rows.append([f"{name}: collocation less shooting", *(spread(e, 100, 2) for e in made)])
    if not rows:
        return _LATER
    headings = ["on the same windows", "joints; all points cm", "legs; hidden points cm",
                "slip cm/s"]  # fmt: skip
    return markdown(headings, rows) + source(*named)


def _only(row: Mapping[str, Any], names: list[str], chosen: list[str]) -> dict[str, Any]:
    """A row's values on some windows."""
    own = row["windows"]
    places = [own.get("names", names).index(name) for name in chosen]
    kept = {key: [v[i] for i in places] for key, v in own.items() if key != "names"}
    return {"windows": {**kept, "names": chosen}}


def _cell(row: Mapping[str, Any], about: Mapping[str, Any], metric: str, columns: Columns) -> str:
    _, factor, digits = columns[metric]
    estimate = estimated(row, about, metric)
    if estimate is None:
        return number(mean(row, metric), factor, digits)
    if estimate.high - estimate.low < 1e-9:
        return number(estimate.mean, factor, digits)
    return spread(estimate, factor, digits)


def _name(method: str) -> str:
    return _NAMES.get(method, method.replace("least squares", "penalised least squares"))


def _plain(method: str) -> str:
    return _name(method).replace("**", "")
