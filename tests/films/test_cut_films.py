"""A film with cuts: one shot of it is taken, and the others are named."""

from dataclasses import replace

import numpy as np
import pytest

from recon.detections.records import detections_of_rows
from recon.detections.tables import detection_arrays, read_detection_arrays
from recon.reading.stated import cut_to_longest_shot
from recon.reading.tracks import tracks_of_people


def film(seen):
    """Somebody in the given frames of three shots, from frames 0, 30 and 50 to 99."""
    body = np.random.default_rng(0).uniform(100, 300, (33, 2))
    rows = [(k, np.column_stack((body + k, np.full(33, 0.8))), -1) for k in seen]
    found = detections_of_rows("film.mp4", range(100), rows)
    return replace(found, frame_rate=10.0, image_size=(640, 480), shots=(30, 50))


def test_the_shot_in_which_people_are_seen_longest_is_taken():
    """People were linked across cuts, to one person who jumps."""
    found, shot, note = cut_to_longest_shot(film([*range(5, 30), *range(60, 75)]), 10.0, None)
    assert shot == (0, 29)
    (track,) = tracks_of_people(found)
    assert (track.frame[0], track.frame[-1]) == (5, 29)
    assert "3 shots" in note
    assert "from 0.00 to 2.90 s" in note
    assert "3.00-4.90, 5.00-9.90 s" in note


def test_the_caller_chooses_a_shot_by_time():
    found, shot, _ = cut_to_longest_shot(film([*range(5, 30), *range(60, 75)]), 10.0, (5.5, 9.0))
    assert shot == (50, 99)
    assert set(found.frame.tolist()) == set(range(60, 75))


@pytest.mark.parametrize("shots", [(), (30, 50)])
def test_shots_are_kept_with_the_detections(tmp_path, shots):
    one = replace(film(range(100)), shots=shots)
    np.savez(tmp_path / "a.npz", **detection_arrays(one))
    again = read_detection_arrays(tmp_path / "a.npz")
    assert again.shots == shots
    assert (cut_to_longest_shot(again, 10.0, None)[1] is None) == (shots == ())


def test_nobody_is_followed_across_a_cut():
    tracks = tracks_of_people(film(range(100)))
    assert [(one.number, one.frame[0], one.frame[-1]) for one in tracks] == [
        (0, 0, 29), (1, 30, 49), (2, 50, 99)
    ]  # fmt: skip
