"""Tables of films of phones."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.tables.values import markdown, number, result, source

_FOCAL = {
    "known": "known", "found": "guessed and found by the fit", "held": "guessed and held",
}  # fmt: skip


def focal() -> str:
    """The focal length told, found and guessed; windows of validation subjects."""
    rows = []
    for name, label in _FOCAL.items():
        found = result("phone")["tables"]["focal"][name]
        ratios = [row["ratio"] for row in found.values() if "ratio" in row]
        rows.append([
            label, number(found["mean"]["about"], 100, 2),
            f"{min(ratios):.2f} to {max(ratios):.2f}", number(found["mean"]["seconds"], 1, 1),
        ])  # fmt: skip
    headings = ["focal length", "about the pelvis cm", "over the true one", "CPU s"]
    return markdown(headings, rows) + source("phone")


_TRACK = {
    "static": "fixed", "undeclared": "carried, believed fixed", "COLMAP": "carried, COLMAP",
    "TUM": "carried, TUM", "DROID-SLAM": "carried, DROID-SLAM", "ARKit": "carried, ARKit",
}  # fmt: skip


def track() -> str:
    """A fixed phone, and a carried one with the files of trackers."""
    rows = []
    for name, label in _TRACK.items():
        found = result("phone_track")["tables"]["track"][name]["mean"]
        rows.append([
            label, number(found["about"], 100, 2), number(found.get("unit"), 1, 2),
            number(found["seconds"], 1, 1),
        ])  # fmt: skip
    headings = ["phone", "about the pelvis cm", "length of the path over the true one", "CPU s"]
    return markdown(headings, rows) + source("phone_track")


def crossings() -> str:
    """Two people who pass each other."""
    scenes = result("crossings")["scenes"]
    rows = []
    for kind in (*dict.fromkeys(one["kind"] for one in scenes), "all"):
        own = [one for one in scenes if kind in ("all", one["kind"])]
        rows.append([
            kind, str(len(own)), str(sum(one["followed"] >= 0.95 for one in own)),
            number(min(one["followed"] for one in own), 100, 0),
            str(sum(one["exchanged"] > 0 for one in own)),
            str(sum(one["said"] > 0 for one in own)),
        ])  # fmt: skip
    headings = [
        "directions",
        "pairs",
        "both followed",
        "least followed %",
        "exchanged",
        "said to be lost",
    ]
    return markdown(headings, rows) + source("crossings")


_USUAL = {
    "in the hand": "in the hand, 0.4°",
    "slow pan": "panned by 4-12°/s, whatever the person does",
    "following": "panned with the person",
    "alongside": "carried beside the person",
    "around": "carried around the person",
}
_HARD = {
    "steady hand": "in a steady hand, 0.2°",
    "gimbal": "carried around the person, on a gimbal",
}


def undeclared() -> str:
    """Cameras that move though nobody says so."""
    clips = result("undeclared")["clips"]
    usual = [one for one in clips if one["kind"] in _USUAL]
    fixed = [one for one in clips if one["kind"] == "fixed"]
    rows = [_said("fixed", fixed)]
    for kinds in (_USUAL, _HARD):
        rows += [_said(label, [c for c in clips if c["kind"] == k]) for k, label in kinds.items()]
        if kinds is _USUAL:
            rows.append(_said("moving, all of these", usual))
    return markdown(["phone", "clips", "said to move", "%"], rows) + source("undeclared")


def _said(label: str, clips: Sequence[Mapping[str, Any]]) -> list[str]:
    said = sum(one["said"] for one in clips)
    return [label, str(len(clips)), str(said), number(said / len(clips), 100, 0)]


def shared_camera() -> str:
    """Two people of one film, alone and together."""
    scenes = result("shared_camera")["scenes"]
    rows = []
    for how in ("alone", "together"):
        own = [one for one in scenes if one["how"] == how]
        means = [sum(one[key] for one in own) / len(own) for key in _SHARED]
        factors = _SHARED.values()
        rows.append([how, *(number(m, f, 1) for m, f in zip(means, factors, strict=True))])
    headings = ["fitted", "about the pelvis cm", "between people cm", "floors apart cm", "CPU s"]
    return markdown(headings, rows) + source("shared_camera")


_SHARED = {"about": 100, "between": 100, "floors": 100, "seconds": 1}
