"""Who moves like whom, and that the committed splits heed it."""

import json
import tomllib
from itertools import pairwise

import pytest
import torch

from benchmarks.likeness import NEAR, directions, distance
from benchmarks.results import RESULTS
from recon.benchmark.dataset import SPLITS, Splits
from recon.body.model import BodyModel
from recon.core import rotations as so3
from tests.benchmarks.test_windows import turning


def test_a_motion_is_no_distance_from_itself_seen_from_elsewhere() -> None:
    motion, body = turning(90, 30.0), BodyModel.load()
    moved = motion.replace(
        rotations=torch.cat(
            [
                so3.about_z(torch.tensor(1.3)) @ motion.rotations[:, :1],
                motion.rotations[:, 1:],
            ],
            1,
        ),
        translation=motion.translation + 3.0,
    )
    one, other = directions(motion, body), directions(moved, body)
    assert one.shape == (30, 21, 3)
    assert distance(one, other) < 0.1  # degrees


def test_a_bent_knee_is_told_in_degrees() -> None:
    motion, body = turning(30, 30.0), BodyModel.load()
    bent = motion.rotations.clone()
    bent[:, 4] = so3.exp(torch.tensor([0.6, 0.0, 0.0]))  # left knee: turns the shank and the foot
    found = distance(directions(motion, body), directions(motion.replace(rotations=bent), body))
    assert found == pytest.approx(2 * 34.4 / 21, rel=0.1)  # two of 21 bones turn by up to 34.4


def test_no_clip_of_unknown_people_near_a_test_person_is_trained_on() -> None:
    """Clips of validation subject 10, and clips that may be of test people, were trained on."""
    found = json.loads((RESULTS / "likeness.json").read_text(encoding="utf-8"))
    splits = Splits.load()
    parts = splits.parts(list(found["unknown"]))
    assert found["near_degrees"] == NEAR
    assert set(splits.test) - {"d2C"} <= set(found["people"])
    assert set(splits.apart) <= set(found["people"])
    trained = {name for name, part in parts.items() if part == "train"}
    assert len(trained) >= 20
    for name in trained:
        assert min(found["unknown"][name].values()) >= NEAR, name
    for take in (2, 4, 5):
        assert parts[f"u_train_soccer_soccer_{take}"] == "validation"
    assert set(found["near"]) <= set(splits.excluded)


def test_16_is_apart_because_35_is_trained_on() -> None:
    found = json.loads((RESULTS / "likeness.json").read_text(encoding="utf-8"))
    splits = Splits.load()
    parts = splits.parts(["16_15", "35_01", "07_01", "10_04", "salsa_01"])
    assert parts == {
        "16_15": "apart", "35_01": "train", "07_01": "test", "10_04": "validation",
        "salsa_01": "train",
    }  # fmt: skip
    assert found["others"]["16"]["35"] < max(found["own"]["07"].values())


def test_listed_test_windows_share_no_frame_and_are_enough() -> None:
    """Ten pairs of the 64 windows of version 0.1.0 overlapped, one by 97 %."""
    splits = Splits.load()
    least = {60: 60, 90: 40}
    for frames, wanted in least.items():
        rows = splits.windows["test"][frames]
        for clip in {clip for clip, _ in rows}:
            starts = sorted(round(start * 30) for other, start in rows if other == clip)
            gaps = [b - a for a, b in pairwise(starts)]
            assert all(gap >= frames for gap in gaps), clip
        counted = [clip for clip, _ in rows if splits.subject(clip) in splits.test]
        assert len(counted) >= wanted
        assert {splits.subject(clip) for clip in counted} == set(splits.test)
        beside = {splits.subject(clip) for clip, _ in rows} - set(splits.test)
        assert beside == set(splits.apart)


def test_the_table_of_splits_is_read_as_it_is_written() -> None:
    table = tomllib.loads(SPLITS.read_text(encoding="utf-8"))
    assert table["test"]["apart"] == ["16"]
    splits = Splits.load()
    assert splits.windows["validation"][60][0] == ("06_01", 1.3)
