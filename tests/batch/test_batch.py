"""Many clips: a manifest that resumes, bad clips that stop nobody, equal shards."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import recon
from recon.batch.batch import fit_all, large_first
from recon.batch.workers import Run, run_jobs
from recon.batch.worklog import BatchClip, clips_of_shard, read_manifest
from recon.core.skeleton import JOINTS
from recon.fitting.settings import FitSettings
from recon.formats.observations import PositionsFile, save_observation
from recon.formats.opening import load_arrays
from recon.formats.replacing import save_arrays
from tests.api.test_front_door import noisy
from tests.batch.batch_jobs import WAYS, here, sum_one


def manifest(folder: Path, *rows: object) -> Path:
    path = folder / "clips.jsonl"
    path.write_text("\n".join(row if isinstance(row, str) else json.dumps(row) for row in rows))
    return path


def observation(path: Path, seed: int) -> Path:
    positions = np.random.default_rng(seed).normal(size=(2, 22, 3))
    save_arrays(path, {"positions": positions})
    return path


@pytest.fixture
def clips(tmp_path) -> tuple[BatchClip, ...]:
    names = "abc"
    for seed, name in enumerate(names):
        observation(tmp_path / f"{name}.npz", seed)
    (tmp_path / "folder").mkdir()
    observation(tmp_path / "folder.npz", 9)
    (tmp_path / "folder" / "1.json").write_text("{}")
    (tmp_path / "folder" / "video.mp4").write_text("large")
    rows = [{"id": name, "observations": [f"{name}.npz"]} for name in names]
    rows.append({"id": "d", "observations": ["folder.npz", "folder"]})
    return read_manifest(manifest(tmp_path, *rows))


def statuses(
    clips, out: Path, settings: FitSettings | None = None, run: Run = here
) -> dict[str, str]:
    log, how = out / "log.jsonl", settings or FitSettings()
    found = fit_all(clips, out, how, 2, log, sum_one, run=run)
    return {record["id"]: record["status"] for record in found}


def test_changing_one_byte_of_any_input_redoes_exactly_that_clip(clips, tmp_path):
    """Folders counted as missing, whatever was in them: old results were kept as if new."""
    out = tmp_path / "out"
    assert statuses(clips, out) == dict.fromkeys("abcd", "ok")
    assert statuses(clips, out) == dict.fromkeys("abcd", "skipped")
    observation(tmp_path / "b.npz", 7)
    assert statuses(clips, out) == dict.fromkeys("acd", "skipped") | {"b": "ok"}
    total = load_arrays(tmp_path / "b.npz")["positions"].sum()
    assert load_arrays(out / "b.npz")["total"] == total
    (tmp_path / "folder" / "1.json").write_text("[]")
    assert statuses(clips, out) == dict.fromkeys("abc", "skipped") | {"d": "ok"}
    (tmp_path / "folder" / "video.mp4").write_text("small")
    assert statuses(clips, out) == dict.fromkeys("abcd", "skipped")


def test_changing_a_setting_or_a_file_that_it_names_redoes_all(clips, tmp_path):
    """Of a calibration only the path counted: rewritten, it left all results as they were."""
    out, camera = tmp_path / "out", tmp_path / "camera.toml"
    camera.write_text("one")
    settings = FitSettings(camera=camera)
    every, none = dict.fromkeys("abcd", "ok"), dict.fromkeys("abcd", "skipped")
    assert statuses(clips, out, settings) == every
    assert statuses(clips, out, settings) == none
    camera.write_text("two")
    assert statuses(clips, out, settings) == every
    assert statuses(clips, out, replace(settings, fps=20.0)) == every
    assert statuses(clips, out, replace(settings, fps=20.0)) == none
    camera.rename(tmp_path / "moved.toml")
    moved = replace(settings, fps=20.0, camera=tmp_path / "moved.toml")
    assert statuses(clips, out, moved) == none  # where a file lies says nothing


def test_a_new_version_of_the_method_redoes_all(clips, tmp_path, monkeypatch):
    assert statuses(clips, tmp_path / "out") == dict.fromkeys("abcd", "ok")
    monkeypatch.setattr("recon.batch.batch.FIT_VERSION", 1_000)
    assert statuses(clips, tmp_path / "out") == dict.fromkeys("abcd", "ok")


def test_results_that_are_lost_or_changed_are_made_again(clips, tmp_path):
    out = tmp_path / "out"
    statuses(clips, out)
    (out / "a.npz").unlink()
    (out / "b.npz").write_bytes(b"half of")
    assert statuses(clips, out) == {"a": "ok", "b": "ok", "c": "skipped", "d": "skipped"}


@pytest.mark.slow
def test_ten_bad_clips_are_lines_of_the_log_and_no_more(clips, tmp_path):
    """A times.csv of 1e-320 s gave an OverflowError: good clips were fitted and not logged."""
    out = tmp_path / "out"
    bad = [BatchClip(name, (tmp_path / "a.npz",)) for name in WAYS]
    both = [*bad[:5], *clips, *bad[5:]]
    expected = dict.fromkeys("abcd", "ok") | {name: kind for name, (_, kind) in WAYS.items()}
    assert statuses(both, out, run=run_jobs) == expected
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert sorted(line["id"] for line in lines) == sorted(expected)
    assert all(line["error"] for line in lines if line["status"] != "ok")
    unexpected = [line for line in lines if line["status"] == "error"]
    assert all("Traceback" in line["traceback"] for line in unexpected)
    # tried again, since memory and programs change; what is known already is not said again
    again = statuses(both, out, run=run_jobs)
    assert again == expected | dict.fromkeys("abcd", "skipped")
    assert len((out / "log.jsonl").read_text().splitlines()) == len(lines)


def test_bad_clips_cost_their_neighbours_nothing(clips, tmp_path):
    out, names = tmp_path / "out", ("refuse", "be_killed", "exhaust")
    bad = [BatchClip(name, (tmp_path / "a.npz",)) for name in names]
    found = fit_all([*bad[:2], *clips, bad[2]], out, FitSettings(), 1, out / "log.jsonl", sum_one)
    expected = dict.fromkeys("abcd", "ok") | {name: WAYS[name][1] for name in names}
    assert {record["id"]: record["status"] for record in found} == expected
    assert statuses(clips, out) == dict.fromkeys("abcd", "skipped")
    with pytest.raises(ValueError, match="at least one process, got 0"):
        list(fit_all(clips, out, FitSettings(), 0, out / "log.jsonl", sum_one))


def test_large_files_come_first(clips, tmp_path):
    (tmp_path / "b.npz").write_bytes(b"-" * 90_000)
    (tmp_path / "c.npz").write_bytes(b"-" * 80_000)
    assert [clip.name for clip in large_first(clips)][:2] == ["b", "c"]
    missing = [BatchClip("none", (tmp_path / "none",)), BatchClip("nothing", ())]
    assert {clip.name for clip in large_first([*missing, *clips])[-2:]} == {"none", "nothing"}


def test_fits_of_a_batch_are_those_of_recon_fit(tmp_path):
    for k, frames in enumerate((6, 8)):
        seen = np.ones((frames, 22), bool)
        file = PositionsFile("joints3d", noisy(frames, 0.01 * (k + 1)), seen, JOINTS, 30.0)
        save_observation(tmp_path / f"{k}.npz", file)
    rows = [{"id": f"clip{k}", "observations": f"{k}.npz"} for k in range(2)]
    clips, out = read_manifest(manifest(tmp_path, *rows)), tmp_path / "out"
    found = fit_all(clips, out, FitSettings(prior="pose"), 1, out / "log.jsonl", run=here)
    assert [record["status"] for record in found] == ["ok"] * 2
    for k in range(2):
        alone = recon.fit(tmp_path / f"{k}.npz", "pose")
        joints = np.load(out / f"clip{k}.npz")["joints"]
        np.testing.assert_allclose(joints, alone.joints.numpy(), atol=1e-5)


@pytest.mark.parametrize("where", ["observation", "report", "camera", "folder"])
def test_results_are_not_written_over_inputs(where, tmp_path):
    """The result of one clip could be the observation of the next."""
    (tmp_path / "in").mkdir()
    a, b = (observation(tmp_path / "in" / f"{name}.npz", 0) for name in "ab")
    clips = {
        "observation": [BatchClip("b", (a,)), BatchClip("c", (b,))],
        "report": [BatchClip("b", (tmp_path / "in" / "b.npz.json",))],
        "camera": [BatchClip("b", (tmp_path / "x.npz",))],
        "folder": [BatchClip("c", (tmp_path / "in",))],
    }[where]
    settings = FitSettings(camera=b) if where == "camera" else FitSettings()
    before = b.read_bytes()
    with pytest.raises(ValueError, match="written over or among inputs"):
        list(fit_all(clips, tmp_path / "in", settings, 1, tmp_path / "log.jsonl", sum_one))
    assert b.read_bytes() == before
    assert not (tmp_path / "log.jsonl").exists()


def test_two_runs_do_not_share_a_log(clips, tmp_path):
    out = tmp_path / "out"
    first = fit_all(clips, out, FitSettings(), 1, tmp_path / "log.jsonl", sum_one)
    next(first)
    with pytest.raises(ValueError, match="another run is writing"):
        next(fit_all(clips, out, FitSettings(), 1, tmp_path / "log.jsonl", sum_one))
    first.close()


def test_manifests_are_checked_line_by_line(tmp_path):
    good = {"id": "a", "observations": "a.npz"}
    assert read_manifest(manifest(tmp_path, good, "")) == (BatchClip("a", (tmp_path / "a.npz",)),)
    for bad, words in (
        (good, "'a' in line 1 and 'a' in line 2"),
        ({"id": "A", "observations": "b.npz"}, "would be written to one file"),
        ("{", "line 2"),
        ("[" * 200_000, "line 2: expected"),
        ('{"id": ' + "7" * 10_000 + ', "observations": []}', "line 2: expected"),
        ("7", "line 2"),
        ({"id": "b"}, "line 2"),
        ({"id": None, "observations": []}, "line 2: expected strings"),
        ({"id": "b", "observations": [7]}, "line 2: expected strings"),
        ({"id": "../b", "observations": []}, "can be a file name"),
        ({"id": "b", "observations": [], "camera": "c.toml"}, "camera cannot differ"),
    ):
        with pytest.raises(ValueError, match=words):
            read_manifest(manifest(tmp_path, good, bad))


def test_manifests_are_text_as_it_comes(tmp_path):
    path = tmp_path / "clips.jsonl"
    path.write_bytes('\ufeff{"id": 7, "observations": "a\u2028.npz"}\r\n'.encode())
    assert read_manifest(path) == (BatchClip("7", (tmp_path / "a\u2028.npz",)),)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="expected text in UTF-8"):
        read_manifest(path)
    path.write_text("\n\n")
    with pytest.raises(ValueError, match="in a line for each clip, got no line"):
        read_manifest(path)


def test_shards_are_a_partition():
    clips = [BatchClip(f"clip {k}", ()) for k in range(50)]
    parts = [clips_of_shard(clips, k, 4) for k in range(4)]
    assert sorted(c.name for part in parts for c in part) == sorted(c.name for c in clips)
    with pytest.raises(ValueError, match="I < N"):
        clips_of_shard(clips, 4, 4)


def test_a_folder_is_a_manifest_of_its_films(tmp_path):
    for name in ("b.mp4", "a.MOV", "a.gif", "notes.txt", ".hidden.mp4"):
        (tmp_path / name).touch()
    clips = read_manifest(tmp_path)
    assert [clip.name for clip in clips] == ["a.MOV", "a.gif", "b"]
    assert [clip.observations for clip in clips] == [
        (tmp_path / name,) for name in ("a.MOV", "a.gif", "b.mp4")
    ]


def test_a_folder_without_films_is_refused(tmp_path):
    with pytest.raises(ValueError, match="expected films in this folder"):
        read_manifest(tmp_path)
