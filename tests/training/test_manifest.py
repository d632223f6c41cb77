"""The manifest of a corpus: written, read, and what trainings take of a clip by it."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from recon.benchmark.dataset import SPLITS, Splits
from recon.core.motion import MotionFile
from recon.formats.motions import save_motion
from tests.priors.test_pose import swinging
from training.manifest import (
    MANIFEST,
    ManifestRow,
    minutes_by_part,
    read_manifest,
    stretches_to_teach,
    write_manifest,
)
from training.settings import CorpusSettings, identity_of_run

ROW = ManifestRow("02_01", "cmu", 0, 30, 1.0, True, True, True, True, "")


def rows_of(clip: str) -> list[ManifestRow]:
    """Four seconds: all lessons, steps without contacts, poses alone, nothing."""
    return [
        replace(ROW, clip=clip),
        replace(ROW, clip=clip, first=30, stop=60, contacts=False, shape=False, why="bones"),
        replace(ROW, clip=clip, first=60, stop=90, steps=False, contacts=False, why="slides"),
        replace(
            ROW, clip=clip, first=90, stop=120, poses=False, steps=False, contacts=False,
            shape=False, why="jump",
        ),
    ]  # fmt: skip


def corpus_with(folder: Path, *clips: str) -> Path:
    """A corpus of clips of four seconds at 30 Hz."""
    for seed, name in enumerate(clips):
        motion = swinging(120, seed, 30.0)
        contacts = torch.ones(120, 22, dtype=torch.float64)
        save_motion(folder / f"{name}.npz", MotionFile(motion, contacts=contacts))
    return folder


def test_a_manifest_survives_its_file(tmp_path: Path) -> None:
    rows = rows_of("02_01")
    write_manifest(rows, tmp_path)
    assert read_manifest(tmp_path) == {"02_01": rows}
    assert read_manifest(tmp_path / "elsewhere") is None


def test_a_damaged_manifest_is_refused_by_its_line(tmp_path: Path) -> None:
    path = write_manifest(rows_of("02_01"), tmp_path)
    path.write_text(path.read_text().replace("0,30,1.0,1", "0,thirty,1.0,1"))
    with pytest.raises(ValueError, match="line 2"):
        read_manifest(tmp_path)


def test_each_lesson_takes_its_own_stretches(tmp_path: Path) -> None:
    path = corpus_with(tmp_path, "02_01") / "02_01.npz"
    rows = rows_of("02_01")
    (poses,) = stretches_to_teach(path, rows, "poses", with_contacts=False)
    assert poses.motion.frames == 90
    kept = stretches_to_teach(path, rows, "poses")
    assert [(p.motion.frames, p.contacts is not None) for p in kept] == [(30, True), (60, False)]
    with_contacts, without = stretches_to_teach(path, rows, "steps")
    assert with_contacts.motion.frames == without.motion.frames == 30
    assert with_contacts.contacts is not None
    assert without.contacts is None
    (whole,) = stretches_to_teach(path, None, "steps")
    assert whole.motion.frames == 120
    torch.testing.assert_close(without.motion.rotations, whole.motion.rotations[30:60])


def test_trainings_take_what_the_manifest_allows(tmp_path: Path) -> None:
    settings = CorpusSettings(corpus_with(tmp_path, "02_01", "35_01"), tmp_path / "out")
    before = identity_of_run(settings)
    assert [clip.motion.frames for clip in settings.load_clips("train")] == [120, 120]
    write_manifest(
        [*rows_of("02_01"), replace(ROW, clip="35_01", poses=False, steps=False)], tmp_path
    )
    assert [clip.name for clip in settings.load_clips("train")] == ["02_01"]
    steps = list(settings.stretches_that_teach("train", "steps"))
    assert [(name, file.motion.frames) for name, _, file in steps] == [("02_01", 30)] * 2
    assert identity_of_run(settings) != before


def test_a_clip_that_the_manifest_does_not_know_is_told(tmp_path: Path) -> None:
    settings = CorpusSettings(corpus_with(tmp_path, "02_01", "35_01"), tmp_path / "out")
    write_manifest(rows_of("02_01"), tmp_path)
    with pytest.raises(ValueError, match=rf"{MANIFEST}: lists no clip 35_01"):
        settings.load_clips("train")


def test_minutes_are_counted_by_collection_and_part() -> None:
    rows = [*rows_of("02_01"), *rows_of("m01_s08_e01_ok"), *rows_of("HDM_mm_kick")]
    found = {
        (row["part"], row["people"], row["minutes"])
        for row in minutes_by_part(rows, Splits.load(SPLITS))
    }
    assert found == {("train", 1, 0.07), ("validation", 1, 0.07), ("none", 1, 0.07)}
