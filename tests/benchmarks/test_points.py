"""Tables of points in space, on the bundled walk and on made-up methods."""

import numpy as np

import recon
from benchmarks.humor import COLUMNS, HUMOR, POSE, compared, kinds, means


def noisy(centimetres: float):
    """A method that is off by so much, in every joint and frame."""

    def given_back(seen):
        return seen.positions * 0 + np.array([0.0, 0.0, centimetres / 100])

    return given_back


def test_methods_are_compared_window_by_window() -> None:
    methods = {POSE: noisy(2.0), HUMOR: noisy(1.0)}
    found = recon.bench("noisy-joints", methods)
    table = means(found, COLUMNS["noisy-joints"])
    assert [row[0] for row in table.rows] == [POSE, HUMOR, "truth"]
    less = compared({"noisy-joints": found}).rows
    assert [row[0] for row in less] == [
        "noisy-joints: joints, cm", "noisy-joints: legs, cm", "noisy-joints: slip a second, cm",
    ]  # fmt: skip
    assert less[-1][1] == 0.0  # who stands still does not slip
    assert less[-1][2] == "inside noise"


def test_kinds_of_motion_begin_with_the_easiest() -> None:
    found = recon.bench("noisy-joints", {POSE: noisy(2.0), HUMOR: noisy(1.0)})
    clips = {name.rsplit("@", 1)[0] for name in found.names}
    hidden = recon.bench("hidden-points", {POSE: Constant(), HUMOR: Constant()})
    table = kinds({"noisy-joints": found, "hidden-points": hidden}, dict.fromkeys(clips, "walk"))
    assert table.rows[0][:2] == ["walk", f"{len(found.names)} of 16"]


class Constant:
    """Every point at the origin."""

    def __call__(self, seen):
        frames, points, _ = seen.positions.shape
        return {"joints": np.zeros((frames, 22, 3)), "points": np.zeros((frames, points, 3))}
