"""Cameras, depth and real detections."""

from benchmarks.tables.values import APART, markdown, mean, number, result, source

_CASES = {
    "one camera": ("cameras", "one camera, ground not known"),
    "one camera, posed": ("cameras", "one camera of known pose"),
    "moving camera": ("cameras", "moving camera of known poses"),
    "three views": ("cameras", "three views"),
    "half a body, one camera, posed": ("cameras_half", "legs never seen, one posed camera"),
    "half a body, three views": ("cameras_half", "legs never seen, three views"),
}
_FILES = tuple(dict.fromkeys(file for file, _ in _CASES.values()))
_METHODS = {
    "stages 1-2": "stages 1-2",
    "HuMoR": "collocation",
    "HuMoR, nc": "collocation, nc",
}


def cameras() -> str:
    """All columns."""
    columns = {
        "root_visible": ("visible cm", 100, 1), "root_hidden": ("hidden cm", 100, 1),
        "joints_all": ("world cm", 100, 1), "vertices": ("vertices cm", 100, 1),
        "accel_error": ("accel. error m/s²", 1, 1), "penetration_freq": ("penetration %", 100, 1),
        "normal": ("normal °", 1, 1), "height": ("height cm", 100, 1), "seconds": ("CPU s", 1, 1),
    }  # fmt: skip
    rows = []
    for case, (file, name) in _CASES.items():
        for method, label in _METHODS.items():
            found = result(file)["tables"].get(case, {}).get(method)
            if found is None:
                continue
            cells = {m: number(mean(found, m), f, d) for m, (_, f, d) in columns.items()}
            rows.append([f"{name}: {label}", *cells.values()])
    return markdown(["case", *(h for h, _, _ in columns.values())], rows) + source(*_FILES)


def summary() -> str:
    """Visible and hidden joints about the pelvis, with and without the motion prior."""
    rows = []
    for case, (file, name) in _CASES.items():
        found = result(file)["tables"].get(case)
        if found is None:
            continue
        pair = [found[method] for method in ("stages 1-2", "HuMoR")]
        seen, unseen = (
            " / ".join(number(mean(row, metric), 100, 1) for row in pair)
            for metric in ("root_visible", "root_hidden")
        )
        apart = " / ".join(number(row.get(APART, {}).get("root_hidden"), 100, 1) for row in pair)
        rows.append([name, seen, unseen, apart])
    headings = ["stages 1-2 / collocation, cm", "visible", "hidden", "16 apart, hidden"]
    return markdown(headings, rows) + source(*_FILES)


def ablations() -> str:
    """One camera under networks that lack one part each."""
    columns = {
        "root_visible": ("visible cm", 100, 1), "root_hidden": ("hidden cm", 100, 1),
        "penetration_freq": ("penetration %", 100, 0), "normal": ("normal °", 1, 1),
    }  # fmt: skip
    found = result("cameras_ablations")["tables"]["one camera"]
    names = ("full", "no-delta", "no-contacts", "no-smpl", "standard-prior", "mvae")
    rows = [
        [
            name,
            *(number(mean(found[f"HuMoR, {name}"], m), f, d) for m, (_, f, d) in columns.items()),
        ]
        for name in names
    ]
    return markdown(["networks", *(h for h, _, _ in columns.values())], rows) + source(
        "cameras_ablations"
    )


def detections() -> str:
    """Real detections of the Pose2Sim recordings: every row that was measured."""
    names = {
        "single_balancing": "balancing on a beam",
        "single_static": "standing, one person",
        "multi_static_p1": "standing, the first of two",
        "multi_static_p2": "standing, the second of two",
        "multi_participants12": "two people, the first",
    }
    rows = []
    for key, row in result("pose2sim")["tables"].items():
        recording, _, views = key.partition(", ")
        rows.append(
            [f"{names[recording]}, {views}", number(row["frames"], 1, 0),
             number(row["triangulation"], 1, 1), number(row["reprojection"], 1, 1),
             number(row.get("away"), 100, 1), number(row.get("world"), 100, 1)]
        )  # fmt: skip
    headings = ["recording", "frames", "points that follow no body px", "body px",
                "joints against three views: about the pelvis cm", "in the room cm"]  # fmt: skip
    return markdown(headings, rows) + source("pose2sim")


def nearest() -> str:
    """What the search for pairs costs."""
    rows = result("nearest")["rows"]
    cells = [
        [str(count), *(number(rows[f"{count} points: {key}"], factor, digits)
         for key, factor, digits in (("objective, ms", 1, 0), ("search, ms", 1, 0),
                                     ("share of the search", 100, 1)))]
        for count in (512, 1024, 4096)
    ]  # fmt: skip
    headings = ["points a frame", "objective and gradient ms", "search ms",
                "share of a stage's time %"]  # fmt: skip
    return markdown(headings, cells) + source("nearest")
