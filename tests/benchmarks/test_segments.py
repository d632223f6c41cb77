"""The study of segments: what drift is of, and lines of its table."""

import torch

from benchmarks.segments import first_state
from benchmarks.tables.segments import lines
from priors.humor.segments import SegmentedHumor
from recon.body.model import BodyModel
from tests.priors.test_humor import humor, motions


def test_drift_is_of_the_first_state_and_the_latents_of_all_segments(body: BodyModel) -> None:
    parts, whole = SegmentedHumor(humor(body), 3), SegmentedHumor(humor(body), 7)
    variables = parts.encode(motions())
    expected = whole.decode(whole.encode(motions()).replace(latents=variables.latents)).motion
    found = humor(body).decode(first_state(variables, parts)).motion
    torch.testing.assert_close(found.rotations, expected.rotations)
    torch.testing.assert_close(found.translation, expected.translation)


def test_lines_are_means_over_windows_and_say_nothing_where_nothing_is() -> None:
    row = {
        "protocol": "noisy joints", "method": "collocation", "joints": 0.01, "hidden": None,
        "thirds": (0.01, 0.02, 0.03), "objective": None, "defect": None, "drift": None,
        "evaluations": 10, "seconds": 2.0, "ended": "converged",
    }  # fmt: skip
    other = {**row, "joints": 0.03, "ended": "iteration_limit"}
    [line] = lines([row, other])
    assert line == [
        "noisy joints, 2 windows", "collocation", "2.00", "1.00 2.00 3.00", "–", "–", "–", "–",
        "10", "2.0", "1 of 2",
    ]  # fmt: skip
