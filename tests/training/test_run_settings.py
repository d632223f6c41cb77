"""A run is continued only as what it is: its settings, and the contents it learns from."""

import dataclasses
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from training.humor.train import HumorTraining
from training.humor.variation import Variation
from training.humos.train import HumosTraining
from training.labels.train import LabelTraining
from training.settings import FREE, identity_of_run, refuse_other_run, settings_to_store

KINDS = (HumorTraining, HumosTraining, LabelTraining)
CHECKPOINT = Path("run/checkpoint.pt")


def settings_of(kind: type, folder: Path) -> Any:
    (folder / "corpus").mkdir(exist_ok=True)
    for name in ("a.npz", "b.npz"):
        (folder / "corpus" / name).write_text(name)
    (folder / "corpus" / "a.json").write_text('{"clip": "a"}')
    for name in ("splits.toml", "weights"):
        (folder / name).write_text(name)
    settings = kind(folder / "corpus", folder / "run", splits=folder / "splits.toml")
    return replace(settings, start=folder / "weights") if kind is HumorTraining else settings


def another(value: Any, field: dataclasses.Field[Any]) -> Any:
    """A value of the same kind."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        first = dataclasses.fields(value)[0]
        return replace(value, **{first.name: another(getattr(value, first.name), first)})
    match value:
        case str():
            choices = getattr(field.type, "__args__", ())
            return next((one for one in choices if one != value), value + "?")
        case tuple():
            return (*value, 2.0)
        case _:
            return type(value)(value / 2) if isinstance(value, float) else value + 1


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        pytest.param(kind, field, id=f"{kind.__name__}-{field.name}")
        for kind in KINDS
        for field in dataclasses.fields(kind)
        if field.name not in ("corpus", "out", "splits", "start")
    ],
)
def test_every_setting_is_held_but_those_that_only_take_time(kind, field, tmp_path):
    """A run was continued with another learning rate, decay or variation without a word."""
    settings = settings_of(kind, tmp_path)
    if kind is HumosTraining and field.name == "latent":
        settings = replace(settings, latent=7)
    changed = replace(settings, **{field.name: another(getattr(settings, field.name), field)})
    found = identity_of_run(settings)
    if field.name in FREE:
        refuse_other_run(CHECKPOINT, identity_of_run(changed), found)
        return
    with pytest.raises(ValueError, match=rf"a run with other {field.name} \(.*; take another"):
        refuse_other_run(CHECKPOINT, identity_of_run(changed), found)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("file", "name"),
    [("corpus/a.npz", "corpus"), ("corpus/a.json", "corpus"), ("splits.toml", "splits"),
     ("weights", "start")],
)  # fmt: skip
def test_contents_are_held_wherever_they_lie(kind, file, name, tmp_path):
    """A corpus that was converted anew, or another one of that name, was learned on from."""
    (tmp_path / "here").mkdir()
    settings = settings_of(kind, tmp_path / "here")
    found = identity_of_run(settings)
    (tmp_path / "here").rename(tmp_path / "there")
    moved = settings_of(kind, tmp_path / "there")
    refuse_other_run(CHECKPOINT, identity_of_run(moved), found)
    if kind is not HumorTraining and file == "weights":
        return
    (tmp_path / "there" / file).write_text('"another"')
    with pytest.raises(ValueError, match=rf"other ({name}) \(its contents differ\)"):
        refuse_other_run(CHECKPOINT, identity_of_run(moved), found)


def test_variations_that_were_unknown_then_and_are_off_now_change_nothing(tmp_path):
    """Every new variation would otherwise end all runs that were interrupted before it came."""
    settings = replace(settings_of(HumorTraining, tmp_path), variation=Variation())
    found = identity_of_run(settings)
    del found["variation"]["raises"]
    refuse_other_run(CHECKPOINT, identity_of_run(settings), found)
    raised = replace(settings, variation=replace(settings.variation, raises=0.5))
    with pytest.raises(ValueError, match="other variation"):
        refuse_other_run(CHECKPOINT, identity_of_run(raised), found)
    with pytest.raises(ValueError, match="other variation"):
        refuse_other_run(CHECKPOINT, found, identity_of_run(raised))


def test_clips_that_come_or_go_are_another_corpus(tmp_path):
    settings = settings_of(HumorTraining, tmp_path)
    found = identity_of_run(settings)
    (tmp_path / "corpus" / "c.npz").write_text("c")
    with pytest.raises(ValueError, match="other corpus"):
        refuse_other_run(CHECKPOINT, identity_of_run(settings), found)


def test_checkpoints_that_do_not_say_what_they_learned_from_are_refused(tmp_path):
    with pytest.raises(ValueError, match="older version"):
        refuse_other_run(CHECKPOINT, identity_of_run(settings_of(HumorTraining, tmp_path)), None)


def test_weights_do_not_tell_where_they_were_trained(tmp_path):
    """Weights that were begun with others told where those lay on the trainer's disk."""
    told = settings_to_store(settings_of(HumorTraining, tmp_path))
    assert str(tmp_path) not in str(told)
    assert told["rate"] == 1e-3


@pytest.mark.parametrize("module", ["training.humor.train", "training.look.train"])
def test_every_setting_of_a_run_is_an_option(module: str) -> None:
    """Two groups of settings had fields of one name, and no option could be parsed."""
    told = subprocess.run(
        [sys.executable, "-m", module, "--help"], capture_output=True, text=True, check=False
    )
    assert told.returncode == 0, told.stderr
    assert "--export" in told.stdout
    assert "--validate-every" in told.stdout
