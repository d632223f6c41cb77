"""The benchmark of batches: its clips, and the cost of a million of them."""

import json

import pytest

from benchmarks import batch
from benchmarks.results import demo_clip
from benchmarks.tables import many
from recon.core.struct import stack
from recon.formats.observations import load_observation


def test_windows_are_drawn_again_where_there_are_more_clips(tmp_path):
    truth = stack([demo_clip(12).window(0, 4), demo_clip(12).window(4, 8)])
    batch.manifest(tmp_path, truth, count=3)
    lines = (tmp_path / "all.jsonl").read_text().splitlines()
    assert [json.loads(line)["id"] for line in lines] == ["0", "1", "2"]
    assert (tmp_path / "one.jsonl").read_text().splitlines() == lines[:1]
    seen = [load_observation(tmp_path / f"{k}.npz").positions for k in (0, 2)]
    assert 0.01 < abs(seen[0] - seen[1]).max() < 0.5


def test_a_command_that_fails_is_no_measurement(tmp_path):
    (tmp_path / "clips.jsonl").write_text('{"id": "a", "observations": "none.npz"}')
    words = ("clips.jsonl", "--out", str(tmp_path / "out"))
    with pytest.raises(RuntimeError, match="1 of 1 clips were not fitted"):
        batch.Command.begun(words, batch.ROOT, tmp_path).ended()


def test_a_million_clips_cost_in_proportion_to_their_frames(monkeypatch):
    cost = {"cpu_seconds": 6.0, "largest_mb": 512.0}
    about = {"command": "python -m benchmarks.batch", "commit": "0" * 40, "date": "today"}
    found = {"about": about, "frames": 60, "clips": 10, "rows": {"pose": {"one by one": cost}}}
    monkeypatch.setattr(many, "result", lambda _: found)
    monkeypatch.setattr(many, "source", lambda _: "")
    row = many.million().splitlines()[2]
    # 10 ms a frame: 60 million frames are 167 hours
    assert [cell.strip() for cell in row.strip("|").split("|")] == [
        "`pose`", "10.0", "200", "800", "5,000", "0.1", "32",
    ]  # fmt: skip
