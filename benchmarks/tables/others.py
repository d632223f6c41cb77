"""Ablations, new motions, long recordings, left-out markers, the corpus, solver, speed, fuzz."""

import numpy as np

from benchmarks.tables.values import (
    NONE,
    SUBJECTS,
    belongs,
    markdown,
    mean,
    number,
    present,
    result,
    source,
)


def ablations() -> str:
    """Networks that lack one part each, one short training schedule."""
    tables = result("ablations")["tables"]["60 frames"]
    noisy, hidden = tables["noisy joints"], tables["occluded points"]
    names = {
        "stages 1-2, tuned": "stages 1-2, tuned", "short: full": "full",
        "short: no-delta": "no delta", "short: no-contacts": "no contacts",
        "short: no-smpl": "no L_SMPL", "short: standard-prior": "standard prior",
        "short: mvae": "MVAE (all four)", "HuMoR": "the default weights",
    }  # fmt: skip
    rows = [
        [label, number(mean(noisy[key], "joints_all"), 100, 2),
         number(mean(noisy[key], "joints_legs"), 100, 2),
         number(mean(noisy[key], "slip_speed"), 100, 1),
         number(mean(noisy[key], "feet_balanced"), 100, 1),
         number(mean(hidden[key], "observed_all"), 100, 2),
         number(mean(hidden[key], "observed_hidden"), 100, 1)]
        for key, label in names.items()
    ]  # fmt: skip
    headings = ["networks", "noisy: all cm", "legs cm", "slip cm/s", "feet right %",
                "occluded: all cm", "hidden cm"]  # fmt: skip
    return markdown(headings, rows) + source("ablations")


def generation() -> str:
    """Samples after true states, and how they stay on their feet."""
    files = ["generation_open", *(["generation_nc"] if present(["generation_nc"]) else [])]
    tables = result("generation_open")["tables"]
    rows = [
        _generated(tables, "held by the ground (default)", "default", "from the mixture"),
        _generated(tables, "default, temperature 1.3", "`--temperature 1.3`", None),
        _generated(tables, "body at the joints", "networks alone", "from the mixture, networks"),
        *(
            _generated(result(nc)["tables"], "held by the ground (default)",
                       "default, nc weights", "from the mixture")
            for nc in files[1:]
        ),
    ]  # fmt: skip
    guess = tables["prediction"]["constant velocity"]
    rows.append(
        ["constant velocity", *[_cm(guess, "ade_mean")] * 2, NONE, _cm(guess, "fde"), *[NONE] * 5]
    )
    recorded = tables["on their feet"]["as recorded, up to 5 s"]["stays"]
    truth = number(mean(tables["prediction"]["truth"], "speed"), 1, 2)
    rows.append(["truth", *[NONE] * 5, truth, NONE, NONE, number(recorded, 100, 0)])
    headings = ["cm", "ADE of a sample, mean", "ADE of the samples' mean", "ADE, best of 50",
                "FDE, best of 50", "APD on their feet", "mean speed m/s",
                "on their feet from the mixture %", "their mean speed m/s",
                "on their feet from true states %"]  # fmt: skip
    return markdown(headings, rows) + source(*files)


def _generated(tables: dict, key: str, label: str, mixture: str | None) -> list[str]:
    """One way to generate."""
    row, feet = tables["prediction"][key], tables["on their feet"]
    made = None if mixture is None else feet[mixture]
    return [
        label,
        *(_cm(row, metric) for metric in ("ade_mean", "ade_of_mean", "ade", "fde", "apd_upright")),
        number(mean(row, "speed"), 1, 2),
        *(number(None if made is None else made[name], factor, digits)
          for name, factor, digits in (("stays", 100, 0), ("speed", 1, 2))),
        number(feet[f"from real states, {key}"]["stays"], 100, 0),
    ]  # fmt: skip


def _cm(row: dict, key: str) -> str:
    return number(mean(row, key), 100, 1)


def long() -> str:
    """Windows over one recording, there and back."""
    rows = []
    for file, method in (("long", "collocation"), ("long_pose", "pose prior")):
        [clips] = result(file)["rows"].values()
        rows += [
            [f"{method}, {clip}, {length}", number(row["cpu_seconds"], 1, 0),
             number(row["peak_mb"], 1, 0), number(row["error"], 100, 2),
             number(row.get("error_in_one_piece"), 100, 2), number(row["jump"], 1, 2),
             number(row["jump_truth"], 1, 2)]
            for clip, lengths in clips.items()
            for length, row in lengths.items()
        ]  # fmt: skip
    headings = ["4 cm of noise", "CPU s", "peak MB", "error cm", "in one piece cm",
                "largest change of velocity at a border m/s", "the truth's m/s"]  # fmt: skip
    return markdown(headings, rows) + source("long", "long_pose")


def live() -> str:
    """Streams beside offline fits of the same clips, and one that goes on for minutes."""
    found = result("live")
    clips = list(found["rows"].values())
    rows = []
    for name in clips[0]:
        every = [clip[name] for clip in clips]
        ratios = [clip[name]["error"] / clip["offline, pose"]["error"] for clip in clips]
        rows.append(
            [name, number(_mean(every, "error"), 100, 2), number(float(np.mean(ratios)), 1, 3),
             number(_mean(every, "step"), 100, 2), number(_mean(every, "step_truth"), 100, 2),
             *(number(_mean(every, key), 1, 0) for key in ("median_ms", "p95_ms", "longest_ms"))]
        )  # fmt: skip
    for name, long in found["long_stream"].items():
        rows.append(
            [f"{name}, {found['minutes']:g} minutes", number(long["error"], 100, 2), NONE,
             number(long["step"], 100, 2), number(long["step_truth"], 100, 2),
             *(number(long[key], 1, 0) for key in ("median_ms", "p95_ms", "longest_ms"))]
        )  # fmt: skip
    headings = ["4 cm of noise", "error cm", "of offline, pose", "99 % step cm", "the truth's cm",
                "CPU ms a push, median", "95 %", "longest"]  # fmt: skip
    return markdown(headings, rows) + source("live")


def _mean(rows: list[dict[str, float]], key: str) -> float | None:
    values = [row[key] for row in rows if key in row]
    return float(np.mean(values)) if values else None


def markers() -> str:
    """Each fifth marker left out and predicted."""
    rows = [
        [row["recording"], str(row["markers"]), number(row["left_out_mm"]),
         number(row["nominal_mm"]), number(row["residual_mm"])]
        for row in result("markers")["rows"]
    ]  # fmt: skip
    headings = ["recording, mm", "markers", "left-out, own offset known", "without its offset",
                "residual of the others"]  # fmt: skip
    return markdown(headings, rows) + source("markers")


def corpus() -> str:
    """What became of the recordings of skeletons."""
    found = result("corpus")
    columns = {
        "pieces": 0, "converted": 0, "rejected": 0, "minutes": 1,
        "residual mm (median clip)": 1, "residual mm (worst clip)": 1, "slip m/s": 4,
        "slip of the source m/s": 4,
    }  # fmt: skip
    rows = [
        [name, *(number(row[key], 1, digits) for key, digits in columns.items())]
        for name, row in found["rows"].items()
    ]
    return markdown(["collection", *columns], rows) + source("corpus")


def solver() -> str:
    """Evaluations on standard problems, beside SciPy's L-BFGS-B."""
    found = result("solver")
    rows = [
        [row["problem"], f"{row['value']:.2g}", f"{row['value_scipy']:.2g}", str(row["solved"]),
         str(row["solved_scipy"])]
        for row in found["problems"]
    ]  # fmt: skip
    rows.append(["all", "", "", str(found["solved"]), str(found["solved_scipy"])])
    headings = ["problem", "minimum found", "SciPy's", "evaluations", "SciPy's"]
    return markdown(headings, rows) + source("solver")


def speed() -> str:
    """Posing, and stages 1 and 2."""
    rows = [[name, number(value, 1, 2)] for name, value in result("speed")["rows"].items()]
    return markdown(["one thread", "value"], rows) + source("speed")


def start() -> str:
    """Starts of commands, beside version 0.1.0."""
    return _beside("start")


def pictures() -> str:
    """Pictures and films, beside version 0.1.0."""
    return _beside("pictures")


def _beside(file: str) -> str:
    """CPU seconds of 0.1.0 and of this version, and their ratio."""
    rows = [
        [name, *(number(row[key], 1, 2) for key in ("baseline", "ours", "ratio"))]
        for name, row in result(file)["rows"].items()
    ]
    return markdown(["CPU s", "0.1.0", "now", "ratio"], rows) + source(file)


def rollout() -> str:
    """One objective and gradient of the published fit's last stage."""
    rows = [
        [f"width {row['width']}, {row['clips']} clips, {row['threads']} threads",
         number(row["naive"], 1, 0), number(row["ours"], 1, 0), number(row["ratio"], 1, 1)]
        for row in result("rollout")["rows"]
    ]  # fmt: skip
    return markdown(["60 frames", "naive ms", "ours ms", "ratio"], rows) + source("rollout")


def fuzz() -> str:
    """What became of spoilt observation files."""
    found = result("fuzz")
    rows = [[name, str(count)] for name, count in found["rows"].items()]
    rows.append(["all", str(sum(found["rows"].values()))])
    rows.append(["tracebacks, NaN, exit codes out of contract", str(len(found["faults"]))])
    return markdown(["spoilt file: outcome (exit code)", "files"], rows) + source("fuzz")


def likeness() -> str:
    """How near people move to the test and validation people."""
    found = result("likeness")
    people = found["people"]
    rows = []
    for name, row in sorted(found["unknown"].items(), key=lambda item: min(item[1].values())):
        nearest = min(row, key=row.__getitem__)
        if row[nearest] < found["near_degrees"] + 1:
            rows.append([f"`{name}`", *(number(row.get(person)) for person in people)])
    for title, pick in (("own takes, median", np.median), ("own takes, greatest", max)):
        own = [list(found["own"][person].values()) for person in people]
        rows.append([title, *(number(float(pick(v))) if v else NONE for v in own)])
    nearest = [min(found["others"][p].items(), key=lambda item: item[1]) for p in people]
    rows.append(["nearest other known person", *(f"{v:.1f} ({who})" for who, v in nearest)])
    return markdown(["degrees from", *people], rows) + source("likeness")


def windows() -> str:
    """How many windows there are, by subject."""
    rows = []
    for frames, file in ((60, "humor"), (90, "humor_90")):
        names = result(file)["windows"][f"{frames} frames"]["names"]
        own = [belongs(name) for name in names]
        counts = [own.count(subject) for subject in (*SUBJECTS, "16")]
        rows.append(
            [f"{frames} frames", *map(str, counts[:3]), str(sum(counts[:3])), str(counts[3])]
        )
    return markdown(["windows", *SUBJECTS, "in the means", "16, apart"], rows) + source(
        "humor", "humor_90"
    )
