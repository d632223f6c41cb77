"""The benchmark of speed: clips that go there and back, and batches."""

import json

import pytest
import torch

from benchmarks.protocol import demo_clip
from benchmarks.speed import cost_of, manifest, there_and_back
from recon.core.struct import stack
from recon.formats.observations import load_observation


def test_a_clip_runs_there_and_back_until_it_is_long_enough() -> None:
    clip = demo_clip(4)
    long = there_and_back(clip, 10 / 30)
    order = [0, 1, 2, 3, 2, 1, 0, 1, 2, 3]
    assert torch.equal(long.translation, clip.translation[order])


def test_windows_are_drawn_again_where_there_are_more_clips(tmp_path) -> None:
    truth = stack([demo_clip(12).window(0, 4), demo_clip(12).window(4, 8)])
    manifest(tmp_path, truth, count=3)
    lines = (tmp_path / "all.jsonl").read_text().splitlines()
    assert [json.loads(line)["id"] for line in lines] == ["0", "1", "2"]
    seen = [load_observation(tmp_path / f"{k}.npz").positions for k in (0, 2)]
    assert 0.01 < abs(seen[0] - seen[1]).max() < 0.5


def test_a_command_that_fails_is_no_measurement(tmp_path) -> None:
    (tmp_path / "clips.jsonl").write_text('{"id": "a", "observations": "none.npz"}')
    with pytest.raises(RuntimeError, match="1 of 1 clips were not fitted"):
        cost_of("clips.jsonl", "--out", str(tmp_path / "out"), folder=tmp_path)
