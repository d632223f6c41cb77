"""Real markers with the lower ones hidden: who is listed, and what means say."""

import tomllib
from pathlib import Path

import pytest
import torch

from benchmarks.protocol import ROOT
from benchmarks.real import (
    EVERYTHING,
    HIDDEN_BELOW,
    HUMOR,
    KINDS,
    POSE,
    HiddenMarkers,
    load_list,
    lower,
    means,
    observation,
)
from recon.body.model import BodyModel

LISTED = load_list()


def test_nobody_in_a_mean_is_learned_from() -> None:
    """Subject 02, whose clips train, was one of the four recordings that were told of."""
    listed = tomllib.loads((ROOT / "training" / "free_recordings.toml").read_text("utf-8"))
    learned = {one["path"] for one in listed["recording"] if one["use"] in ("train", "validation")}
    counted = [one for one in LISTED if one.row != "apart"]
    assert not learned & {f"observations/{one.path.split('::')[0]}" for one in counted}
    assert not [one for one in counted if one.person.startswith("CMU") or one.why]
    assert all(one.why for one in LISTED if one.row == "apart")


def test_each_recording_is_listed_once_and_is_there(data: Path) -> None:
    paths = [one.path for one in LISTED]
    assert len(set(paths)) == len(paths)
    assert all((data / "observations" / path.split("::")[0]).is_file() for path in paths)


def test_every_overground_run_and_walk_of_the_folders_is_listed(data: Path) -> None:
    """Four recordings out of thirty had been chosen, nobody knew how."""
    words = ("run", "walk", "_DJ")
    folders = ("nimblephysics", "opensim")
    found = {
        f"{folder}/{path.name}"
        for folder in folders
        for path in (data / "observations" / folder).glob("*.trc")
        if any(word in path.stem for word in words) and "static" not in path.stem
    }
    assert found <= {one.path for one in LISTED}


def test_a_clip_begins_where_the_list_says_and_hides_what_is_low(data: Path) -> None:
    """BMC's walker enters the volume after 1.33 s, before which no marker is seen."""
    one = next(one for one in LISTED if one.path == "bmc/Gait.c3d")
    seen = observation(data / "observations" / one.path, BodyModel.load(), one.first)
    assert bool(seen.visible[0, 0].sum() > 10)
    hidden = lower(seen)
    assert bool((seen.positions[hidden][:, 2] < HIDDEN_BELOW).all())
    assert 0.3 < hidden.sum() / seen.visible.sum() < 0.8
    assert not bool((hidden & ~seen.visible).any())
    assert seen.positions.shape[1] / seen.fps == pytest.approx(3.0, abs=0.1)
    assert torch.isfinite(seen.positions).all()


def test_means_are_over_people_and_not_over_recordings() -> None:
    told = {"a/1": ("A", 10.0), "a/2": ("A", 20.0), "b/1": ("B", 35.0)}
    errors = {
        HiddenMarkers(kind, path, person): {POSE: 2 * error, HUMOR: error, EVERYTHING: 1.0}
        for kind in KINDS
        for path, (person, error) in told.items()
    }
    for row in means(errors).rows:
        assert row[1] == 2
        assert str(row[2]).startswith("3 of ")
        pose, humor = row[3], row[4]
        assert isinstance(pose, list)
        assert isinstance(humor, list)
        assert (pose[0], humor[0]) == (50.0, 25.0)  # the mean of 15 and 35
        assert row[-1] == 0.5
