"""Free recordings beside the main collection: used as the splits say, with their licences."""

import json
from pathlib import Path

import pytest
import torch

from benchmarks.free_recordings import (
    PARTS,
    FreeRecording,
    convert_one,
    counted,
    falls,
    load_list,
    note_licence,
)
from recon.benchmark.dataset import Splits, clip_files
from recon.body.model import BodyModel
from tests.standing_body import standing

RECORDINGS, LICENCES = load_list()


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda one: one.path)
def test_the_list_says_what_the_splits_say(recording: FreeRecording) -> None:
    """A recording that is listed as not learned from must not be in the training part by name."""
    splits = Splits.load()
    part = splits.parts([recording.clip_name]).get(recording.clip_name)
    if recording.use in PARTS:
        assert part == recording.use
        assert splits.subject(recording.clip_name) not in (*splits.test, *splits.apart)
    else:
        assert recording.clip is None, "only what is learned from becomes a clip here"
    if recording.path.startswith("mocap/") and recording.use == "none":
        assert part is None, "recon convert --all makes a clip of it, so it must be excluded"


def test_every_licence_has_its_words_and_only_open_ones_are_learned_from() -> None:
    assert {one.licence for one in RECORDINGS} == set(LICENCES)
    assert {one.licence for one in RECORDINGS if one.use in PARTS} <= {"CMU", "MIT"}


def test_nobody_is_both_learned_from_and_tested() -> None:
    learned = {one.person for one in RECORDINGS if one.use in PARTS}
    assert not learned & {one.person for one in RECORDINGS if one.use == "test"}


def test_every_free_recording_is_listed(data: Path) -> None:
    """Recordings that nobody had looked at were left out of training without a word."""
    listed = {one.path for one in RECORDINGS}
    for folder in ("bmc", "rehazenter", "pycgm", "mocaprecovery", "cmu_c3d", "mocaptoolbox"):
        for path in (data / "observations" / folder).iterdir():
            if path.suffix in (".c3d", ".trc", ".mat"):
                assert path.relative_to(data).as_posix() in listed
    assert all((data / path).exists() for path in listed)


def test_markers_become_a_clip_with_its_licence(data: Path, tmp_path: Path) -> None:
    recording = next(one for one in RECORDINGS if one.clip == "pycgm-robo_static")
    path = convert_one(data, tmp_path, recording, BodyModel.load())
    note_licence(path, recording, LICENCES)
    assert clip_files(tmp_path) == {"pycgm-robo_static": path}
    notes = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    assert notes["licence"] == "MIT"
    assert "cadop" in notes["terms"]
    assert notes["action"] == "stand still, T-pose"
    assert notes["seconds"] == pytest.approx(2.333, abs=1e-3)
    assert notes["residual_mm"] < 5.0


def test_minutes_are_counted_by_part_and_by_what_they_teach() -> None:
    notes = {
        "01_01": {"seconds": 60.0, "flat": False, "contacts": True},
        "salsa_01": {"seconds": 120.0, "flat": True, "contacts": False},
        "131_01": {"seconds": 30.0, "flat": True, "contacts": True},
        "u_train_jumping_jumping_1": {"seconds": 30.0},
        "06_01": {"seconds": 6.0},
        "06_08": {"seconds": 600.0},
        "07_01": {"seconds": 600.0},
        "dataset-1_bow_active_001": {"seconds": 600.0},
    }
    found = counted(notes, Splits.load())
    assert found["train"] == {
        "clips": 4,
        "people": 3,
        "minutes": 4.0,
        "minutes on flat ground": 3.0,
        "minutes with contacts": 1.0,
    }
    assert found["validation"]["minutes"] == pytest.approx(0.1)
    assert found["validation"]["people"] == 1


def test_a_thrown_body_falls_as_the_unit_of_length_says(body: BodyModel) -> None:
    """The scale of subject 131's files was not known."""
    fps = 60.0
    time = torch.arange(90, dtype=torch.float64) / fps
    path = torch.zeros(90, 3, dtype=torch.float64)
    path[:, 2] = (9.81 / 2 * (time - 0.5) * (0.9 - time)).clamp(min=0.0)
    assert falls(standing(body, path, fps), body) == pytest.approx(9.81, abs=0.05)
    assert falls(standing(body, 2 * path, fps), body) == pytest.approx(19.62, abs=0.1)
    assert falls(standing(body, 0 * path, fps), body) is None
