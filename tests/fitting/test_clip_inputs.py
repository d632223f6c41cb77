"""What a fit depends on: files that are read count by content, all others not at all."""

import importlib
from dataclasses import replace
from pathlib import Path

import pytest

from recon.fitting.settings import FitSettings
from recon.formats.replacing import MISSING, file_checksum
from recon.reading.inputs import (
    clip_checksum,
    input_checksums,
    observation_input,
    settings_checksum,
)


def written(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    return folder


PARTS = ("body", "left_hand", "right_hand")
FOLDERS = {
    "scans": (("scan_1.ply", "scan_2.PLY", "times.csv"), ("video.mp4", "notes.txt", "other.csv")),
    "depth": (("1.png", "2.png", "times.csv"), ("video.mp4",)),
    "detections": (("cam_1.json", "cam_2.json"), ("video.mp4", "old/cam_1.json")),
    "views": (("a/1.json", "b/1.json"), ("a/video.mp4", "video.avi")),
    "tables": (("a.csv", "b.csv"), ("a.avi",)),
    "session": (
        ("a_by_frame.csv", *(f"output_data/mediapipe_{part}_3d_xyz.npy" for part in PARTS)),
        ("a.mp4", "output_data/face.npy"),
    ),
    "project": (("pose/a/1.json", "pose/b/1.json"), ("videos/a.mp4", "pose/a/1.txt")),
}


@pytest.mark.parametrize("kind", FOLDERS)
def test_of_a_folder_those_files_count_that_are_read(kind, tmp_path):
    """Everything below a folder was hashed whole: videos beside detections cost all memory."""
    read, beside = FOLDERS[kind]
    folder = written(tmp_path / kind, *read, *beside)
    found = observation_input(folder)
    assert sorted(file.relative_to(folder).as_posix() for file in found.files) == sorted(read)
    before = found.checksum()
    for name in beside:
        (folder / name).write_text("changed")
    assert observation_input(folder).checksum() == before
    for name in read:
        (folder / name).write_text("changed")
        after = observation_input(folder).checksum()
        assert after != before, name
        before = after


def test_folders_that_hold_nothing_and_files_that_are_not_there_have_checksums(tmp_path):
    (tmp_path / "empty").mkdir()
    assert observation_input(tmp_path / "none").checksum() == MISSING
    empty = observation_input(tmp_path / "empty").checksum()
    written(tmp_path / "empty", "1.json")
    assert observation_input(tmp_path / "empty").checksum() != empty


def test_a_time_table_that_appears_changes_a_folder_of_scans(tmp_path):
    folder = written(tmp_path / "scans", "1.ply")
    before = observation_input(folder).checksum()
    written(folder, "times.csv")
    assert observation_input(folder).checksum() != before


NAMED = {
    "camera": ("calibration.toml", "cameras/1.yml", "opencv/intri.yml", "opencv/extri.yml"),
    "masks": ("masks.npz", "masks/1.png"),
    "body": ("body.npz",),
    "weights": ("humor.safetensors",),
}


@pytest.mark.parametrize(
    ("name", "file"), [(name, file) for name, files in NAMED.items() for file in files]
)
def test_files_that_settings_name_count_by_content(name, file, tmp_path):
    """Of calibration, weights, body and masks only the path counted: old results stayed."""
    written(tmp_path, *NAMED[name])
    given = tmp_path / file if name != "camera" or "/" not in file else (tmp_path / file).parent
    given = given.parent if file == "masks/1.png" else given
    settings = replace(FitSettings(), **{name: str(given) if name == "weights" else given})
    before = settings_checksum(settings, 1)
    assert settings_checksum(settings, 1) == before
    (tmp_path / file).write_text("changed")
    assert settings_checksum(settings, 1) != before


def test_the_pose_of_a_camera_counts_when_its_lens_is_given(tmp_path):
    """EasyMocap's extri.yml is read whenever intri.yml is given."""
    written(tmp_path, "intri.yml", "extri.yml")
    settings = replace(FitSettings(), camera=tmp_path / "intri.yml")
    before = settings_checksum(settings, 1)
    (tmp_path / "extri.yml").write_text("changed")
    assert settings_checksum(settings, 1) != before


@pytest.mark.parametrize(
    "changed", [{"fps": 30.0}, {"prior": "pose"}, {"seed": 1}, {"between": (0.0, 1.0)}]
)
def test_settings_count(changed):
    assert settings_checksum(replace(FitSettings(), **changed), 1) != settings_checksum(
        FitSettings(), 1
    )
    assert settings_checksum(FitSettings(), 2) != settings_checksum(FitSettings(), 1)


def test_a_clip_is_its_observations_in_their_order(tmp_path):
    a, b = (written(tmp_path, name) / name for name in ("a.npz", "b.npz"))
    first = clip_checksum([a, b], "settings")
    assert clip_checksum([b, a], "settings") != first
    assert clip_checksum([a, b], "other settings") != first
    moved = tmp_path / "elsewhere"
    written(moved, "a.npz", "b.npz")
    assert clip_checksum([moved / "a.npz", moved / "b.npz"], "settings") == first


def test_reports_name_all_that_was_given(tmp_path):
    observation = written(tmp_path, "a.npz") / "a.npz"
    camera = written(tmp_path, "c.toml") / "c.toml"
    found = input_checksums({"observations": (observation,), "camera": camera})
    assert found == {str(p): file_checksum(p) for p in (observation, camera)}


@pytest.mark.parametrize("what", ["prior", "reader"])
def test_another_code_of_an_own_class_is_another_fit(tmp_path, monkeypatch, what):
    """Results of an edited prior of one's own were kept as if its class had not changed."""
    monkeypatch.syspath_prepend(tmp_path)
    module = tmp_path / f"own_{what}.py"
    settings = FitSettings(**{what: f"own_{what}:Own"})
    missing = settings_checksum(settings, 1)
    module.write_text("class Own: pass")
    importlib.invalidate_caches()
    before = settings_checksum(settings, 1)
    assert before == settings_checksum(settings, 1) != missing
    module.write_text("class Own: width = 1")
    assert settings_checksum(settings, 1) != before
