"""Leave-one-person-out: who is held out, what the others learn from, and how results compare."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.strangers import compare
from benchmarks.strangers.choice import kind_of_motion, spread, starts
from benchmarks.strangers.compare import tables
from benchmarks.strangers.fits import feet_right
from benchmarks.strangers.folds import (
    GROUP,
    directions,
    distance,
    folds,
    without_doubles,
    write_splits,
)
from benchmarks.strangers.training import Schedule, humor_settings
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.core import rotations as so3
from tests.benchmarks.test_windows import turning
from training.humor.variation import VARIED

SECONDS = {
    "01_01": 22.9, "02_01": 15.0, "02_02": 15.0, "06_01": 29.0, "07_01": 36.0, "11_01": 5.0,
    "12_01": 14.7, "16_15": 28.0, "27_01": 8.6, "35_01": 93.0, "49_01": 187.0,
    "martial_03": 148.0, "salsa_01": 915.0, "u_train_jumping_jumping_1": 200.0,
    "u_train_soccer_soccer_2": 4.9, "10_01": 17.0, "dataset-1_bow_active_001": 900.0,
    "dataset-2_walk_normal_006": 400.0, "dataset-2_walk_active_006": 400.0,
}  # fmt: skip
"""Like the corpus: 07, 49, 16 and d2C are tested."""


@pytest.fixture
def splits() -> Splits:
    return Splits.load()


def test_everybody_outside_test_is_held_out_once(splits: Splits) -> None:
    found = {fold.name: fold.people for fold in folds(SECONDS, splits)}
    together = found.pop(GROUP)
    assert together == ("11", "12", "27")  # less than 20 s of each
    assert list(found) == ["01", "02", "06", "10", "135", "35", "60"]
    assert all(people == (name,) for name, people in found.items())


def test_nobody_learns_from_who_is_held_out_or_tested(splits: Splits) -> None:
    for fold in folds(SECONDS, splits):
        parts = fold.splits.parts(list(SECONDS))
        learned = {splits.subject(clip) for clip, part in parts.items() if part == "train"}
        judged = {splits.subject(clip) for clip, part in parts.items() if part == "validation"}
        assert judged == set(fold.people)
        assert not learned & {*fold.people, "07", "49", "16", "d2C"}
        # the other folds' people do teach, those of the usual validation part among them
        assert learned >= {"02", "06", "35", "60", "unknown"} - set(fold.people)


def test_parts_survive_the_file_that_trainings_read(splits: Splits, tmp_path: Path) -> None:
    for fold in folds(SECONDS, splits):
        assert Splits.load(write_splits(fold.splits, tmp_path / "splits.toml")) == fold.splits


def test_unknown_clips_that_move_like_the_person_are_not_learned_from(splits: Splits) -> None:
    """A run of an unknown person was in the training of the fold of the only runner."""
    [fold] = [own for own in folds(SECONDS, splits) if own.name == "35"]
    generator = torch.Generator().manual_seed(0)
    moves = {
        clip: torch.nn.functional.normalize(
            torch.randn(20, 21, 3, generator=generator, dtype=torch.float64), dim=-1
        )
        for clip in SECONDS
    }
    double = "u_train_jumping_jumping_1"
    assert without_doubles(fold, moves).splits.parts(list(moves))[double] == "train"
    moves[double] = moves["35_01"][3:8]
    assert double not in without_doubles(fold, moves).splits.parts(list(moves))


def test_nothing_of_a_training_is_chosen_on_the_held_out_people(tmp_path: Path) -> None:
    settings = humor_settings(tmp_path, tmp_path, Schedule(steps=700))
    assert settings.validate_every == settings.steps == 700  # one row, so the last is the best
    assert settings.start is None
    assert settings.variation == VARIED


def test_windows_share_no_frame_and_begin_with_the_middle() -> None:
    assert starts(59, 60) == []
    assert starts(100, 60) == [20]
    places = starts(300, 60)
    assert places[0] == 120
    assert sorted(places) == [0, 60, 120, 180, 240]
    assert sorted(starts(250, 60)) == [1, 63, 126, 188]


def test_windows_are_spread_over_kinds_and_clips() -> None:
    walks = [[(f"walk {k}", 0), (f"walk {k}", 60)] for k in range(9)]
    runs = [[("run", 0)]]
    rows = spread([walks, runs], 6)
    assert ("run", 0) in rows
    assert [clip for clip, _ in rows if clip != "run"] == [f"walk {k}" for k in (0, 2, 4, 6, 8)]
    assert len(spread([walks, runs], 100)) == 19
    assert spread([], 4) == []


def test_kinds_are_told_by_words() -> None:
    assert kind_of_motion("walk on uneven terrain") == "uneven ground"
    assert kind_of_motion("run/jog") == "run"
    assert kind_of_motion("salsa dance") == "dance"
    assert kind_of_motion("wash self") == "other"


def row(window: str, method: str, error: float | None, **more: object) -> dict[str, object]:
    return {
        "window": window, "frames": 60, "method": method,
        "protocol": "noisy joints", "error": error, "slip": 0.02,
        "slip_truth": 0.04, "network": None, "labels": (8, 10, 30, 40), **more,
    }  # fmt: skip


NETWORK, OWN = (10, 10, 30, 40), (9, 10, 30, 40)


def fold_of(factor: float) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for k in range(6):
        window, error = f"35_0{k}@0.00", 0.01 * (k + 1)
        rows.append(row(window, "pose", error))
        rows.append(row(window, "humor", factor * error, network=NETWORK, labels=OWN))
    return rows


def test_ratios_are_of_the_same_windows() -> None:
    sums = compare.ratio(fold_of(0.8), "noisy joints")
    assert sums is not None
    found = compare.estimated(sums, compare.quotient)
    assert found.mean == pytest.approx(0.8)
    assert (found.low, found.high) == pytest.approx((0.8, 0.8))  # paired: every window says so
    assert compare.ratio(fold_of(0.8), "gap") is None
    missing = [row("35_09@0.00", "pose", None), row("35_09@0.00", "humor", 0.5)]
    more = compare.ratio([*fold_of(0.8), *missing], "noisy joints")
    assert more is not None
    np.testing.assert_allclose(more, sums)


def test_other_people_are_drawn_where_folds_are_averaged() -> None:
    """With folds that stay, an interval would say nothing of strangers."""
    sums = [compare.ratio(fold_of(factor), "noisy joints") for factor in (0.6, 0.8, 1.0)]
    found = compare.over_people([own for own in sums if own is not None], compare.quotient)
    assert found.mean == pytest.approx(0.8)
    assert found.low < 0.7
    assert found.high > 0.9


def test_contacts_are_compared_by_balanced_accuracy() -> None:
    counts = compare.contacts(fold_of(1.0), "noisy joints")
    assert counts is not None
    found = compare.estimated(counts, compare.more_balanced)
    # under HuMoR 9 of 10 and 30 of 40, under the pose prior 8 of 10 and 30 of 40
    assert found.mean == pytest.approx(0.9 / 2 - 0.8 / 2)
    beside = compare.network(fold_of(1.0), "noisy joints")
    assert beside is not None
    # the network: all of 10 and 30 of 40; then the motion that it helped to find
    assert beside[0].tolist() == [10, 10, 30, 40, 9, 10, 30, 40]
    assert math.isclose(compare.balanced(np.array([3.0, 4.0, 0.0, 0.0])), 0.75)


def test_feet_are_counted_by_what_is_true() -> None:
    said = torch.zeros(2, 22, dtype=torch.bool)
    touching = said.clone()
    said[0, [7, 10]] = True
    touching[:, 7] = True
    said[1, 4] = True  # a knee counts for nothing
    assert feet_right(said, touching) == (1, 2, 5, 6)


def test_the_table_has_a_line_for_every_fold_and_one_for_all() -> None:
    found = {
        name: {"people": people, "rows": fold_of(factor)}
        for name, people, factor in (("35", ["35"], 0.8), (GROUP, ["11", "27"], 0.9))
    }
    made = tables(found, "a note")
    first, second, mean = made["strangers"].rows
    assert first[:2] == ["35", 0.8]  # paired: every window says so
    assert second[0] == f"{GROUP} (11, 27)"
    assert mean[:2] == ["**all 2**", pytest.approx([0.85, 0.80, 0.90])]
    assert mean[3] is None  # no gap was measured


def test_a_motion_is_no_distance_from_itself_seen_from_elsewhere() -> None:
    motion, body = turning(90, 30.0), BodyModel.load()
    rotations = motion.rotations.clone()
    rotations[:, 0] = so3.about_z(torch.tensor(1.3)) @ rotations[:, 0]
    moved = motion.replace(rotations=rotations, translation=motion.translation + 3.0)
    one, other = directions(motion, body), directions(moved, body)
    assert one.shape == (30, 21, 3)
    assert distance(one, other) < 0.1  # degrees


def test_a_bent_knee_is_told_in_degrees() -> None:
    motion, body = turning(30, 30.0), BodyModel.load()
    bent = motion.rotations.clone()
    bent[:, 4] = so3.exp(torch.tensor([0.6, 0.0, 0.0]))  # left knee: turns the shank and the foot
    found = distance(directions(motion, body), directions(motion.replace(rotations=bent), body))
    assert found == pytest.approx(2 * 34.4 / 21, rel=0.1)  # two of 21 bones turn by up to 34.4
