"""Which frames calibrate a subject, and when its recording has a ground."""

import dataclasses

import numpy as np
import pytest
import torch

from recon.body.model import BodyModel
from recon.ingest import marker_fit as fit
from recon.ingest.marker_calibration import SubjectEnergies
from recon.ingest.marker_poses import PoseEnergies
from recon.ingest.marker_sets import full_body_markers
from recon.mocap.recording import MarkerRecording


def lifted(markers: MarkerRecording, metres: float) -> MarkerRecording:
    return dataclasses.replace(markers, positions=markers.positions + np.array([0, 0, metres]))


def test_calibration_frames_are_even_where_all_markers_are_seen() -> None:
    visible, every = torch.ones(301, 4, dtype=torch.bool), torch.ones(301, dtype=torch.bool)
    chosen = fit._frames_with_most_markers(visible, every)
    assert len(chosen) == fit.CALIBRATION_FRAMES
    assert (chosen[0], chosen[-1]) == (0, 300)
    assert int(chosen.diff().max()) <= 3
    placed = every.clone()
    placed[:100] = False
    assert int(fit._frames_with_most_markers(visible, placed)[0]) == 100


def test_poor_frames_calibrate_a_marker_that_is_seen_in_no_others() -> None:
    visible, every = torch.ones(40, 4, dtype=torch.bool), torch.ones(40, dtype=torch.bool)
    visible[:, 3] = False
    visible[20:36, 3] = True  # the fourth marker in frames where another one is hidden
    visible[20:36, 0] = False
    visible[:4, 1] = False
    # all frames with three markers are taken, so that the fourth is seen in 16
    assert fit._frames_with_most_markers(visible, every).tolist() == list(range(4, 40))
    visible[20:36, 1] = False  # these show half of the most, so that even they are needed
    chosen = fit._frames_with_most_markers(visible, every).tolist()
    assert set(range(20, 36)) <= set(chosen)
    visible[20:36, 3] = False
    assert fit._frames_with_most_markers(visible, every).tolist() == [
        *range(4, 20),
        *range(36, 40),
    ]


def test_a_ground_is_where_the_lowest_markers_are_as_high_as_those_of_feet(
    markers: MarkerRecording, single: BodyModel
) -> None:
    assert fit.ground_is_zero(markers)
    low = np.where(markers.visible, markers.positions[..., 2], np.inf).min(-1)
    for metres, stands in ((0.07, True), (0.09, False), (-0.01, False)):
        assert fit.ground_is_zero(lifted(markers, metres - float(np.quantile(low, 0.1)))) is stands
    unseen = dataclasses.replace(markers, visible=np.zeros_like(markers.visible))
    assert not fit.ground_is_zero(unseen)
    known = full_body_markers(markers, single)
    assert fit.subject_energies(markers, known, single).under is not None
    assert fit.subject_energies(lifted(markers, 1.0), known, single).under is None


def test_calibration_frames_are_apart_and_count_as_thirty_a_second(
    markers: MarkerRecording, single: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Turning is per frame at 30 Hz, so that its weight does not hang on the recording's rate."""

    def taken(some: SubjectEnergies, *_: object) -> None:
        poses.append(some.poses)
        raise InterruptedError

    poses: list[PoseEnergies] = []
    monkeypatch.setattr(fit, "calibrated_frames", taken)
    known = full_body_markers(markers, single)
    for rate in (markers.fps, 4 * markers.fps):
        subject = fit.subject_energies(dataclasses.replace(markers, fps=rate), known, single)
        with pytest.raises(InterruptedError):
            fit._calibrated_to_frames(subject.frames(torch.arange(5)), known.bones)
    for one in poses:
        assert one.weight == 1.0
        assert not one.linked.any()
        torch.testing.assert_close(one.turning, torch.full_like(one.turning, fit.TURNING_WEIGHT))
