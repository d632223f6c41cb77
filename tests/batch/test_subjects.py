"""Batches in which clips of one subject share one shape."""

import json
from pathlib import Path

import numpy as np
import pytest

from recon.batch import batch as subjects
from recon.batch.batch import fit_all
from recon.batch.worklog import clips_of_shard, read_manifest
from recon.core.skeleton import JOINTS
from recon.fitting.settings import FitSettings
from recon.formats.observations import PositionsFile, save_observation
from tests.api.test_front_door import noisy
from tests.batch.batch_jobs import here


def written(folder: Path, names: dict[str, str | None]) -> Path:
    """Observation files with a manifest that says whose clips they are."""
    rows = []
    for k, (name, subject) in enumerate(names.items()):
        positions = noisy(6, 0.01 * (k + 1))
        file = PositionsFile("joints3d", positions, np.ones((6, 22), bool), tuple(JOINTS), 30.0)
        save_observation(folder / f"{name}.npz", file)
        row = {"id": name, "observations": f"{name}.npz"}
        rows.append(row if subject is None else row | {"subject": subject})
    path = folder / "clips.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)))
    return path


def test_clips_of_a_subject_have_one_shape_and_a_run_goes_on(tmp_path):
    clips = read_manifest(written(tmp_path, {"a": "anna", "b": "anna", "c": None}))
    out, settings = tmp_path / "out", FitSettings(prior="pose")

    def run(some=clips) -> dict[str, str]:
        found = fit_all(some, out, settings, 1, out / "log.jsonl", run=here)
        return {record["id"]: record["status"] for record in found}

    assert run() == dict.fromkeys("abc", "ok")
    betas = {name: np.load(out / f"{name}.npz")["betas"] for name in "abc"}
    np.testing.assert_array_equal(betas["a"], betas["b"])
    assert np.abs(betas["a"] - betas["c"]).max() > 1e-3
    report = json.loads((out / "a.npz.json").read_text())
    np.testing.assert_allclose(report["settings"]["shape"], betas["a"], atol=1e-6)
    assert run() == dict.fromkeys("abc", "skipped")
    # without its sister, anna's shape is another
    assert run(clips[:1]) == {"a": "ok"}


def test_clips_of_a_subject_stay_in_one_part(tmp_path):
    clips = read_manifest(written(tmp_path, dict.fromkeys("abcdef", "anna")))
    parts = [len(clips_of_shard(clips, k, 3)) for k in range(3)]
    assert sorted(parts) == [0, 0, 6]


def test_what_is_no_subject_is_refused(tmp_path):
    path = written(tmp_path, {"a": None})
    path.write_text('{"id": "a", "observations": "a.npz", "subject": ["x"]}')
    with pytest.raises(ValueError, match=r"line 1: expected a name as subject, got \['x'\]"):
        read_manifest(path)
    clips = read_manifest(written(tmp_path, {"a": "anna"}))
    with pytest.raises(ValueError, match="finds one for each gait cycle"):
        subjects.shapes_of_subjects(clips, FitSettings(prior="anchor"), 1, tmp_path / "l", "")


def test_the_first_look_at_shapes_has_a_method_of_its_own(tmp_path):
    """The pose prior, which is fitted in one way only, would refuse the batch's method."""
    clip = read_manifest(written(tmp_path, {"a": "anna"}))[0]
    settings = FitSettings(method="rollout")
    found = subjects.estimate_shape(subjects.FitJob(clip, tmp_path, settings, "checksum", {}))
    assert len(found["shape"]) > 0
