"""Residuals of every kind of observation: zero at the truth, where seen, in their unit."""

import torch

from recon.core.residuals import Residuals
from recon.diagnosis.findings import Finding, listed, spans, stretches


def test_what_was_not_seen_has_no_residual():
    values = torch.tensor([[[3.0, 4.0, 0.0], [1.0, 0.0, 0.0]]])
    weights = torch.tensor([[1.0, 0.0]])
    residuals = Residuals(values * weights[..., None], weights, "metres")
    assert residuals.seen.tolist() == [[True, False]]
    assert residuals.distances[residuals.seen].tolist() == [5.0]


def test_runs_of_flags_are_stretches_of_frames():
    flags = torch.tensor([True, False, True, True, False, True]).numpy()
    assert stretches(flags) == ((0, 0), (2, 3), (5, 5))
    assert stretches(~flags & False) == ()


def test_long_lists_are_cut_in_sentences():
    assert listed(["a", "b"]) == "a, b"
    assert listed(["a", "b", "c"], most=2) == "a, b and 1 more"
    assert spans([(3, 3)]) == "frame 3"
    assert spans([(3, 3), (5, 9)]) == "frames 3, 5-9"


def test_a_finding_is_a_plain_record_in_reports():
    found = Finding("zeros", "points at zero", ("head",), ((0, 4),), 0.2)
    assert found.report() == {
        "code": "zeros",
        "message": "points at zero",
        "joints": ("head",),
        "frames": ((0, 4),),
        "value": 0.2,
        "sensors": (),
    }
