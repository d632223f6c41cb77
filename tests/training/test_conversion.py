"""The conversion to one corpus: clips are made once, sources told apart, minutes counted."""

import csv
import json
from pathlib import Path

import torch

from recon.batch.collection import SourceClip
from recon.body.model import BodyModel
from recon.diagnosis.findings import Finding
from recon.ingest.conversion import Conversion
from tests.standing_body import path, standing, times
from training.conversion import convert_changed, source_of, write_usable_seconds
from training.manifest import read_manifest

BODY = BodyModel.load()


def found(residual: float = 0.004) -> Conversion:
    """Somebody who stands for two seconds, met by markers; worse in the second second."""
    time = times(2.0, 30.0)[:-1]
    motion = standing(BODY.to(dtype=torch.float64), path(like=time), 30.0).to(dtype=torch.float32)
    return Conversion(
        motion=motion,
        joints=BODY.pose(motion).joints,
        contacts=torch.zeros(60, 22, dtype=torch.bool),
        residuals={"LASI": 4.0},
        ground_shift=0.0,
        decisions=(),
        report={"seconds": 2.0, "residual_mm": 4.0},
        diagnosis=(
            Finding("residual", "", (), ((0, 29),), residual),
            Finding("residual", "", (), ((30, 59),), 0.05),
        ),
    )


def always(one: SourceClip, body: BodyModel) -> tuple[Conversion, bool]:
    return found(), True


def test_clips_are_made_once_and_anew_when_their_recording_changes(tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    recording.write_text("first")
    clip = SourceClip("ui_prmd", "m01_s01_e01_ok", recording)
    made: list[str] = []

    def maker(one: SourceClip, body: BodyModel) -> tuple[Conversion, bool]:
        made.append(one.name)
        return found(), True

    for _ in range(2):
        convert_changed([clip], tmp_path, BODY, maker)
    assert len(made) == 1
    recording.write_text("second")
    convert_changed([clip], tmp_path, BODY, maker)
    assert len(made) == 2
    (tmp_path / "ui_prmd" / "m01_s01_e01_ok.npz").write_bytes(b"cut")
    convert_changed([clip], tmp_path, BODY, maker)
    assert len(made) == 3


def test_a_recording_that_cannot_be_converted_leaves_the_others(tmp_path: Path) -> None:
    clips = [SourceClip("ui_prmd", name, Path(__file__)) for name in ("bad", "good")]

    def maker(one: SourceClip, body: BodyModel) -> tuple[Conversion, bool]:
        if one.name == "bad":
            raise ValueError("no markers")
        return found(), True

    convert_changed(clips, tmp_path, BODY, maker)
    assert [path.name for path in (tmp_path / "ui_prmd").glob("*.npz")] == ["good.npz"]


def test_what_the_markers_are_unsure_of_is_in_the_manifest_and_the_minutes(tmp_path: Path) -> None:
    clip = SourceClip("ui_prmd", "m01_s08_e01_ok", Path(__file__), None, {"action": "deep squat"})
    convert_changed([clip], tmp_path, BODY, always)
    write_usable_seconds(tmp_path, BODY)
    rows = read_manifest(tmp_path)
    assert rows is not None
    assert [(row.first, row.stop, row.poses) for row in rows[clip.name]] == [
        (0, 30, True), (30, 60, False),
    ]  # fmt: skip
    with (tmp_path / "minutes.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["collection"], row["part"], row["people"]) == ("ui_prmd", "validation", "1")
    assert (float(row["minutes"]), float(row["poses"])) == (0.03, 0.02)
    noted = json.loads((tmp_path / "ui_prmd" / f"{clip.name}.json").read_text())
    assert noted["action"] == "deep squat"


def test_people_who_play_too_fast_and_copied_motions_are_known() -> None:
    assert not source_of("118_03", "cmu_windows", "118", {"contacts": False}).true_rate
    assert not source_of("118_03", "cmu_windows", "118", {"contacts": False}).own_bones
    humanoid = source_of("90_05", "cmu_deepmimic", "90", {"contacts": False})
    assert humanoid.retargeted
    assert humanoid.true_rate
    plain = source_of("09_01", "cmu_amc", "09", {"flat": True, "contacts": True})
    assert plain.own_bones
    assert plain.true_rate
    assert plain.flat
    assert not plain.retargeted
