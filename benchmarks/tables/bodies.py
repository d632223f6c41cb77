"""Another body, and HUMOS as a prior."""

from benchmarks.tables.values import (
    APART,
    NONE,
    SUBJECTS,
    markdown,
    mean,
    number,
    result,
    source,
)

_METHODS = {
    "truth": "truth, its own body",
    "copy": "copy",
    "copy-G": "copy, on the ground (-G)",
    "scaled": "path scaled by the legs, on the ground",
    "foot IK": "the same with inverse kinematics of the feet",
    "physics only": "**physics alone**, from the scaled motion (default)",
    "open, proposed": "open weights, proposed",
    "open": "open weights",
    "nc, proposed": "nc weights, proposed",
    "nc": "nc weights",
}
_COLUMNS = {
    "penetrate": ("penetrate cm", 100, 2), "float": ("float cm", 100, 2),
    "skate": ("skate %", 100, 1), "dynamic_stability": ("dyn. stability %", 100, 1),
    "bos_distance": ("BoS dist cm", 100, 1),
    "stability_supported": ("stable, corrected %", 100, 1),
    "bos_distance_supported": ("BoS dist, corrected cm", 100, 1),
    "slip_in_contact": ("slip m/s", 1, 3), "sum": ("sum", 1, 2),
}  # fmt: skip


def retargeting() -> str:
    """All methods over the clips without flight."""
    published = ["1.23", "1.04", NONE, "71.9", "14.6", *[NONE] * 4]
    return _methods("without flight", ("HUMOS, published, other clips", published))


def flight() -> str:
    """All clips, a run and a cartwheel with them."""
    return _methods("pooled")


def _methods(group: str, *more: tuple[str, list[str]]) -> str:
    found = result("retarget")["methods"]
    rows = [
        [label, *(number(found[key][group].get(m), f, d) for m, (_, f, d) in _COLUMNS.items())]
        for key, label in _METHODS.items()
    ]
    rows += [[label, *cells] for label, cells in more]
    return markdown(["", *(h for h, _, _ in _COLUMNS.values())], rows) + source("retarget")


def drawn_bodies() -> str:
    """Bodies of recorded people and bodies drawn from the shape space, and 16 for itself."""
    found = result("retarget")["methods"]
    rows = [
        [f"{label}: {group}",
         *(number(found[key][group].get(m), f, d) for m, (_, f, d) in _COLUMNS.items())]
        for group in ("bodies of people", "bodies drawn", APART)
        for key, label in (("truth", "truth"), ("scaled", "scaled path"), ("open", "open weights"))
    ]  # fmt: skip
    return markdown(["", *(h for h, _, _ in _COLUMNS.values())], rows) + source("retarget")


def losses() -> str:
    """What each loss of the HUMOS training is worth."""
    columns = {
        "penetrate cm": 2, "float cm": 2, "stable %": 1, "BoS cm": 1, "slip m/s": 3, "turned": 1,
        "codes cm": 1,
    }  # fmt: skip
    rows = [
        [name, *(number(row.get(key), 1, digits) for key, digits in columns.items())]
        for name, row in result("humos_ablations")["rows"].items()
    ]
    headings = ["", "penetrate cm", "float cm", "stable %", "BoS cm", "slip m/s", "turned °",
                "codes, own body, cm"]  # fmt: skip
    return markdown(headings, rows) + source("humos_ablations")


def shapes() -> str:
    """What codes say of the body."""
    files = {name: result(f"retarget_shapes_{name}")["rows"] for name in ("open", "nc")}
    rows = [
        ["codes alone on the own body: joints, cm, mean over subjects without 16",
         *(number(sum(f["reconstruction"][s] for s in SUBJECTS) / len(SUBJECTS))
           for f in files.values())],
        *([f"of which {s}{', apart' if s == APART else ''}",
           *(number(f["reconstruction"][s]) for f in files.values())]
          for s in (*SUBJECTS, APART)),
        *([f"R² of a linear probe for the shape: {key}",
           *(number(f["probe"][key], 1, 2) for f in files.values())]
          for key in files["open"]["probe"]),
        *([f"local rotations change from body to body: {key}",
           *(number(f["changed"][key]) for f in files.values())]
          for key in files["open"]["changed"]),
    ]  # fmt: skip
    return markdown(["", *files], rows) + source("retarget_shapes_open", "retarget_shapes_nc")


_PRIORS = {
    "stages 1-2": "no motion prior (stages 1-2)", "HuMoR": "collocation with HuMoR's networks",
    "HUMOS": "HUMOS", "HUMOS, codes": "HUMOS, codes moved", "truth": "truth",
}  # fmt: skip


def prior_noisy() -> str:
    """HUMOS as a prior, noisy joints."""
    return _prior("noisy joints", {
        "joints_all": ("all cm", 100, 2), "joints_legs": ("legs cm", 100, 2),
        "penetration_freq": ("toes below ground %", 100, 2), "slip_speed": ("slip cm/s", 100, 1),
        "feet_balanced": ("feet right %", 100, 1),
    })  # fmt: skip


def prior_hidden() -> str:
    """HUMOS as a prior, hidden points."""
    return _prior("occluded points", {
        "observed_all": ("all cm", 100, 2), "observed_visible": ("seen", 100, 2),
        "observed_hidden": ("hidden", 100, 1), "joints_legs": ("legs cm", 100, 1),
        "penetration_freq": ("toes below ground %", 100, 1), "slip_speed": ("slip cm/s", 100, 1),
    })  # fmt: skip


def _prior(name: str, columns: dict[str, tuple[str, float, int]]) -> str:
    found = result("humos_prior")["tables"][name]
    rows = [
        [label, *(number(mean(found[key], m), f, d) for m, (_, f, d) in columns.items())]
        for key, label in _PRIORS.items()
    ]
    return markdown([name, *(h for h, _, _ in columns.values())], rows) + source("humos_prior")


def physics() -> str:
    """Physics in fits of HuMoR's networks."""
    errors = {
        "joints_all": ("joints cm", 100, 2), "penetration_freq": ("toes penetrate %", 100, 2),
        "penetration_dist": ("depth mm", 1000, 2), "slip_speed": ("slip cm/s", 100, 1),
        "seconds": ("CPU s", 1, 1),
    }  # fmt: skip
    frames = {"physdiff_penetrate": ("skin of feet, depth mm", 1000, 2),
              "physdiff_float": ("float, all frames mm", 1000, 1),
              "slip_in_contact": ("slip in own contact cm/s", 100, 1),
              "dynamic_stability": ("stability %", 100, 0),
              "bos_distance_supported": ("BoS dist cm", 100, 1)}  # fmt: skip
    names = {"HuMoR": "collocation", "HuMoR, as many steps": "as many steps",
             "HuMoR, physics": "physics", "truth": "truth"}  # fmt: skip
    rows = []
    for case, found in result("physics_fit")["tables"].items():
        for key, label in names.items():
            own = found["errors"].get(key, {})
            pooled = found["physics"].get(key, {})
            cells = [number(mean(own, m), f, d) for m, (_, f, d) in errors.items()]
            cells += [number(pooled.get(m), f, d) for m, (_, f, d) in frames.items()]
            rows.append([f"{case}: {label}", *cells])
    headings = [h for h, _, _ in (*errors.values(), *frames.values())]
    return markdown(["", *headings], rows) + source("physics_fit")
