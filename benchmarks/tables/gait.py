"""Cycles of gait: what there is, encoding, completion, interpolation."""

from typing import Any

import numpy as np

from benchmarks.tables.values import APART, NONE, markdown, number, present, result, source

_PARTS = {
    "training": "train", "validation": "validation", "test": "test", "16, apart": "apart",
}  # fmt: skip


def cycles() -> str:
    """Cycles by part and licence."""
    found = result("cycles")["cycles"]
    rows = []
    for part, key in _PARTS.items():
        for licence in ("open", "nc only"):
            row = found.get(f"{key}, {licence}")
            if row is None:
                continue
            actions = ", ".join(
                f"{name} {count}" for name, count in list(row["actions"].items())[:4]
            )
            rows.append(
                [f"{part}, {licence}", str(row["cycles"]), str(row["clips"]),
                 str(row["subjects"]), number(row["minutes"], 1, 1),
                 number(row["mean_duration"], 1, 2), actions]
            )  # fmt: skip
    headings = ["part", "cycles", "clips", "people", "minutes", "mean duration s",
                "most frequent actions"]  # fmt: skip
    return markdown(headings, rows) + source("cycles")


def reconstruction() -> str:
    """Encoding and decoding beside principal components, like for like."""
    sets = result("anchor_reconstruction_nc")["sets"]
    names = {
        "model, drawn code": "256 + 16 numbers, drawn code",
        "PCA-272": "272 principal components",
        "PCA-72": "72 principal components, as published",
        "model, mean code": "256 + 16 numbers, mean code (keeps what a drawn code loses)",
        "phase 1, drawn code": "before training on the surface, drawn code",
        "phase 1, mean code": "before training on the surface, mean code",
    }
    rows = []
    for key, name in names.items():
        if key not in sets["CMU"]["rows"]:
            continue
        cells = []
        for one in ("CMU", "d2C"):
            row = sets[one]["rows"][key]
            squared, mm, ms = _reconstruction(row)
            cells += [number(squared, 1, 0), number(mm, 1, 1), number(ms, 1, 1)]
        rows.append([name, *cells])
    headings = ["nc, mean over cycles", "CMU mm²", "mm", "ms", "d2C mm²", "mm", "ms"]
    return markdown(headings, rows) + source("anchor_reconstruction_nc")


def _reconstruction(row: dict[str, Any]) -> tuple[float, float, float]:
    keys = list(row)
    squared = next(k for k in keys if "mm2" in k)
    mm = next(k for k in keys if k.endswith(" mm") or k == "mm")
    ms = next(k for k in keys if "ms" in k)
    return row[squared], row[mm], row[ms]


def study() -> str:
    """Size of the code and weight of its divergence."""
    rows = [
        [number(row["latent"], 1, 0), f"{row['kl']:g}", number(row["vertex_cm"]),
         number(row["sampled_vertex_cm"]), number(row["kl_nats"], 1, 0),
         number(row["nearest_cm"]), number(row["lowest_cm"])]
        for row in result("anchor_study")["rows"]
    ]  # fmt: skip
    headings = ["numbers of the code", "KL weight", "mean code cm", "drawn code cm", "KL nats",
                "nearest cm", "lowest cm"]  # fmt: skip
    return markdown(headings, rows) + source("anchor_study")


def structure() -> str:
    """How well labels cluster, in codes and in principal components."""
    rows = []
    for part, row in result("anchor_structure")["parts"].items():
        code, pca = row["code"], row["PCA-72"]
        rows.append(
            [part, number(code["silhouette"], 1, 2), number(pca["silhouette"], 1, 2),
             number(code["1-NN"], 1, 2), number(pca["1-NN"], 1, 2),
             number(code["most frequent label"], 1, 2)]
        )  # fmt: skip
    headings = ["cycles", "silhouette: codes", "72 components", "1-NN: codes", "72 components",
                "guessing"]  # fmt: skip
    return markdown(headings, rows) + source("anchor_structure")


def interpolation() -> str:
    """Speed of the held foot halfway, as decoded and settled."""
    rows = []
    for part, pairs in result("anchor_interpolation")["parts"].items():
        for name, one in pairs.items():
            cells = [
                f"{_slip(one, key)} -> {_slip(one, f'{key}, settled')}"
                for key in ("ours", "PCA-72", "slerp")
            ]
            recorded = ", ".join(_slip(one, f"recorded, k = {k}") for k in (0, 1))
            rows.append([f"{part}: {name}", str(one["pairs"]), *cells, recorded])
    headings = ["m/s, decoded -> settled", "pairs", "codes", "72 components", "slerp", "recorded"]
    return markdown(headings, rows) + source("anchor_interpolation")


def _slip(one: dict[str, Any], key: str) -> str:
    return number(one["rows"][key]["slip m/s"], 1, 2)


def morphology() -> str:
    """One code decoded for several bodies."""
    rows = [
        [name, number(row["duration ms"]), number(row["mean mm"]), number(row["greatest mm"]),
         number(row["pelvis on pelvis, mean mm"]), number(row["pelvis on pelvis, greatest mm"])]
        for name, row in result("anchor_morphology")["kept"].items()
    ]  # fmt: skip
    own = result("anchor_morphology")["own_body"]
    rows += [
        [f"validation cycles with {key.removesuffix(' mm')}", NONE, number(value), *[NONE] * 3]
        for key, value in own.items()
    ]
    headings = ["decoded for", "duration ms", "vertices mm, mean", "greatest",
                "pelvis on pelvis, mean", "greatest"]  # fmt: skip
    return markdown(headings, rows) + source("anchor_morphology")


_COMPLETED = {
    "nc weights": ("complete_nc",),
    "open weights": ("complete_open",),
}
_SEEN = {
    "p=0": "16 landmarks in every frame", "p=50+lm": "and 50 points", "p=100+lm": "and 100 points",
    "p=1000+lm": "and 1,000 points", "f=5+lm": "5 of 100 frames, all points and landmarks",
    "f=20+lm": "20 of 100 frames, likewise", "p=50": "50 points in every frame, no landmarks",
    "p=10000": "10,000 points, no landmarks", "f=5": "5 of 100 frames, no landmarks",
    "f=20": "20 of 100 frames, no landmarks",
}  # fmt: skip
_PUBLISHED = {"p=0": "42 ± 48", "p=50+lm": "23 ± 7", "p=100+lm": "21 ± 9", "p=1000+lm": "20 ± 10",
              "f=5+lm": "30 ± 14", "f=20+lm": "20 ± 10"}  # fmt: skip


def _chamfer(files: tuple[str, ...], column: str) -> str:
    """Chamfer distance over the cycles of the test subjects without 16, and its deviation."""
    for file in present(files):
        found = result(file)["cycles"].get(column)
        if found is not None:
            values = [row["chamfer"] for name, row in found.items() if name[:2] != APART]
            return f"{np.mean(values):.1f} ± {np.std(values):.1f}"
    return NONE


def completion() -> str:
    """The two sets of weights, and the published numbers on other scans."""
    rows = [
        [name, *(_chamfer(files, column) for files in _COMPLETED.values()),
         _PUBLISHED.get(column, NONE)]
        for column, name in _SEEN.items()
    ]  # fmt: skip
    files = [file for files in _COMPLETED.values() for file in files]
    headings = ["seen", *_COMPLETED, "published, other scans"]
    return markdown(headings, rows) + source(*files)


def completion_beside() -> str:
    """What else completes the same cycles."""
    methods = {
        "a cycle as one code": ("complete_nc",),
        "as published": ("complete_published",),
        "single poses, no smoothness": ("complete_frames",),
        "pose prior and its smoothness": ("complete_smooth",),
        "`recon fit --prior pose`": ("complete_pose",),
        "collocation": ("complete_collocation",),
    }
    columns = ("p=0", "p=50+lm", "f=5+lm", "p=50")
    rows = [
        [_SEEN[column], *(_chamfer(files, column) for files in methods.values())]
        for column in columns
    ]
    files = dict.fromkeys(file for files in methods.values() for file in present(files))
    return markdown(["seen", *methods], rows) + source(*files)


def real_markers() -> str:
    """Real recordings of gait, reduced to 11 to 16 landmarks."""
    found = result("anchor_real")
    rows = [
        [name, *(number(found["mean"][key + frames]["mean"], 1, 1)
                 for key in ("nc, 16", "open, 16", "pose, 16"))]
        for name, frames in (("landmarks in all frames", ""), ("in 5 of 100 frames", ", f=5"))
    ]  # fmt: skip
    rows.append(
        [
            "fit of all markers, which saw them",
            number(found["mean"]["all markers"]["mean"]),
            NONE,
            NONE,
        ]
    )
    headings = ["given, mm", "nc", "open", "pose prior and smoothness"]
    return markdown(headings, rows) + source("anchor_real")


def speed() -> str:
    """Seconds of one completion."""
    seconds = result("anchor_speed")["seconds"]
    one = seconds["p=0"]
    rows = [
        ["one `recon complete`, start and weights included",
         number(seconds["p=0, command"]["processor_s"], 1, 1)],
        ["one completion in a running process", number(one["single_s"], 1, 1)],
        [f"each of a batch of {result('anchor_speed')['batch']}", number(one["batch_s"], 1, 1)],
    ]  # fmt: skip
    return markdown(["landmarks alone", "CPU s"], rows) + source("anchor_speed")


def priors() -> str:
    """The network, components, and priors of poses and steps, paired by cycle."""
    found = result("cycle_priors")["tables"]
    rows = [
        [f"{_SEEN.get(column, column)}: {name}", str(row["fits"]), _three(row["chamfer"]),
         _three(row["chamfer less"]), _three(row["vertices"]), number(row["seconds"], 1, 1)]
        for column, every in found.items()
        for name, row in every.items()
    ]  # fmt: skip
    headings = ["seen: method", "fits", "Chamfer mm", "less the network's", "vertices mm",
                "CPU s"]  # fmt: skip
    return markdown(headings, rows) + source("cycle_priors")


def recordings() -> str:
    """Whole recordings, with cycles of gait and without."""
    found = result("recordings")["tables"]
    rows = [
        [f"{case}, {'no cycles' if name == 'none' else 'cycles of gait'}", str(row["clips"]),
         number(row["vertices"][0], 1, 1), number(row["vertices less"][0], 1, 1),
         number(row["worst_tenth"], 1, 1),
         number(row["jump"], 1, 2), number(row["jump_truth"], 1, 2),
         number(row["seconds"], 1, 0)]
        for case, every in found.items()
        for name, row in every.items()
        if row
    ]  # fmt: skip
    headings = ["seen", "clips", "vertices mm", "less those without", "worst tenth of moments",
                "largest jump m/s", "true one", "CPU s"]  # fmt: skip
    return markdown(headings, rows) + source("recordings")


def _three(numbers: list[float]) -> str:
    return "{:.1f} ({:.1f} to {:.1f})".format(*numbers)
