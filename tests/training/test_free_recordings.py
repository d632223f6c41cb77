"""Free recordings beside the main collection: used as the splits say, and under free licences."""

import tomllib
from pathlib import Path

import pytest

from recon.benchmark.dataset import Splits

LIST = Path(__file__).parents[2] / "training" / "free_recordings.toml"
TABLE = tomllib.loads(LIST.read_text(encoding="utf-8"))
RECORDINGS = TABLE["recording"]
PARTS = ("train", "validation")


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda one: one["path"])
def test_the_list_says_what_the_splits_say(recording: dict[str, str]) -> None:
    """A recording that is listed as not learned from must not be in the training part by name."""
    splits = Splits.load()
    name = recording.get("clip") or Path(recording["path"]).name.split(".")[0]
    part = splits.parts([name]).get(name)
    if recording["use"] in PARTS:
        assert part == recording["use"]
        assert splits.subject(name) not in (*splits.test, *splits.apart)
    else:
        assert "clip" not in recording, "only what is learned from becomes a clip here"
    if recording["path"].startswith("mocap/") and recording["use"] == "none":
        assert part is None, "recon convert --all makes a clip of it, so it must be excluded"


def test_every_licence_has_its_words_and_only_open_ones_are_learned_from() -> None:
    assert {one["licence"] for one in RECORDINGS} == set(TABLE["licences"])
    assert {one["licence"] for one in RECORDINGS if one["use"] in PARTS} <= {"CMU", "MIT"}


def test_nobody_is_both_learned_from_and_tested() -> None:
    learned = {one["person"] for one in RECORDINGS if one["use"] in PARTS}
    assert not learned & {one["person"] for one in RECORDINGS if one["use"] == "test"}


def test_every_free_recording_is_listed(data: Path) -> None:
    """Recordings that nobody had looked at were left out of training without a word."""
    listed = {one["path"] for one in RECORDINGS}
    for folder in ("bmc", "rehazenter", "pycgm", "mocaprecovery", "cmu_c3d", "mocaptoolbox"):
        for path in (data / "observations" / folder).iterdir():
            if path.suffix in (".c3d", ".trc", ".mat"):
                assert path.relative_to(data).as_posix() in listed
    assert all((data / path).exists() for path in listed)
