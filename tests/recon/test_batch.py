"""Many clips: a manifest that resumes, bad clips that stop nobody, equal shards."""

import json
from pathlib import Path

import pytest

from recon.batch import Clip, fit_all, read_manifest, shard
from recon.settings import FitSettings
from recon.simulate import Corruption
from recon.simulate_files import simulate_file
from tests.recon.test_cli import clip  # noqa: F401


def manifest(folder: Path, *rows: object) -> Path:
    path = folder / "clips.jsonl"
    path.write_text("\n".join(row if isinstance(row, str) else json.dumps(row) for row in rows))
    return path


def test_a_run_is_resumed_and_a_bad_clip_stops_nobody(clip, tmp_path):  # noqa: F811
    for name in ("a", "b"):
        simulate_file(clip, tmp_path / f"{name}.npz", "joints3d", Corruption(noise=0.02), seed=1)
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    rows = [{"id": name, "observations": [f"{name}.npz"]} for name in ("a", "bad", "b")]
    clips = read_manifest(manifest(tmp_path, *rows))
    out, log = tmp_path / "out", tmp_path / "out" / "log.jsonl"
    first = {row["id"]: row["status"] for row in fit_all(clips, out, FitSettings(), 1, log)}
    assert first == {"a": "ok", "b": "ok", "bad": "bad input"}
    (out / "b.npz").unlink()
    with log.open("a") as lines:
        lines.write('{"id": "a", "stat')  # a run cut in the middle of a line
    again = {row["id"]: row["status"] for row in fit_all(clips, out, FitSettings(), 1, log)}
    assert again == {"a": "skipped", "b": "ok", "bad": "bad input"}


def test_manifests_are_checked_line_by_line(tmp_path):
    good = {"id": "a", "observations": "a.npz"}
    assert read_manifest(manifest(tmp_path, good, "")) == (Clip("a", (tmp_path / "a.npz",)),)
    for bad, words in (
        (good, "twice"),
        ("{", "line 2"),
        ({"id": "b"}, "line 2"),
        ({"id": "../b", "observations": []}, "names a file"),
    ):
        with pytest.raises(ValueError, match=words):
            read_manifest(manifest(tmp_path, good, bad))


def test_shards_are_a_partition():
    clips = [Clip(f"clip {k}", ()) for k in range(50)]
    parts = [shard(clips, k, 4) for k in range(4)]
    assert sorted(c.name for part in parts for c in part) == sorted(c.name for c in clips)
    with pytest.raises(ValueError, match="I < N"):
        shard(clips, 4, 4)
