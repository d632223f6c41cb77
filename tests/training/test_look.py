"""Training the network that looks first: what is seen of windows, and runs that go on."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from priors.look.looking import load_network
from recon.body.model import BodyModel, forward_kinematics
from tests.training.test_humor import AS_RECORDED, corpus_of
from tests.training.test_humor import folder as folder
from training.humor.corpus import Corpus
from training.look.seeing import CLEAR, SLOTS
from training.look.train import LookRun, LookTraining, export_weights, points_seen
from training.run import read_state

EXACT = replace(CLEAR, noise=(1e-6, 1.1e-6))


def windows_of(folder: Path, frames: int = 40):
    corpus = corpus_of(folder, BodyModel.load())
    return corpus, corpus.draw(8, frames, AS_RECORDED, torch.Generator().manual_seed(0))


def test_clear_joints_are_the_true_ones(folder: Path) -> None:
    corpus, windows = windows_of(folder)
    seen = points_seen(windows, EXACT, corpus.body, torch.Generator().manual_seed(0))
    assert seen.positions.shape == (8, 40, SLOTS, 3)
    assert seen.visible[:, :, :22].all()
    assert not seen.visible[:, :, 22:].any()
    torch.testing.assert_close(seen.positions[:, :, :22], windows.states.joints, rtol=0, atol=1e-4)
    assert seen.exists.all()


def test_points_on_the_skin_move_with_their_bones(folder: Path) -> None:
    corpus, windows = windows_of(folder)
    skin = replace(EXACT, as_joints=0.0)
    seen = points_seen(windows, skin, corpus.body, torch.Generator().manual_seed(0))
    rotations = torch.cat((windows.states.root[..., None, :, :], windows.states.pose), -3)
    turns, _ = forward_kinematics(rotations, windows.rest)
    for window in range(8):
        bones = seen.bone[window]
        carried = windows.states.joints[window, :, bones]
        carried = carried + (turns[window, :, bones] @ seen.offset[window, :, :, None])[..., 0]
        torch.testing.assert_close(seen.positions[window], carried, rtol=0, atol=1e-4)
        assert 6 <= int(seen.visible[window, 0].sum()) <= SLOTS


@pytest.mark.parametrize("kind", ["below", "limbs", "gap", "single_points", "single_frames"])
def test_each_kind_hides_something_and_leaves_something(folder: Path, kind: str) -> None:
    corpus, windows = windows_of(folder)
    seeing = replace(CLEAR, **{kind: 1.0})
    seen = points_seen(windows, seeing, corpus.body, torch.Generator().manual_seed(3))
    share = float(seen.visible[:, :, :22].float().mean())
    assert 0.05 < share < 0.98


@pytest.mark.numerics
def test_training_goes_on_as_if_it_was_never_cut(folder: Path, tmp_path: Path) -> None:
    body = BodyModel.load()

    def settings(out: str) -> LookTraining:
        return LookTraining(
            corpus=folder / "corpus", out=tmp_path / out, splits=folder / "splits.toml", steps=4,
            windows=2, frames=20, width=32, validate_every=2, save_every=0.0,
        )  # fmt: skip

    def run(out: str) -> LookRun:
        own = settings(out)
        own.out.mkdir(exist_ok=True)
        held_out = Corpus.load(own, "validation", body)
        return LookRun(own, corpus_of(folder, body), held_out)

    run("whole").train_to_end()
    cut = run("cut")
    for _ in range(3):
        losses = cut.losses()
        cut.descend(losses["total"], cut.rate())
    cut.save()
    run("cut").train_to_end()
    whole, continued = (read_state(tmp_path / out / "checkpoint.pt") for out in ("whole", "cut"))
    assert whole is not None
    assert continued is not None
    assert whole["step"] == continued["step"] == 4
    for name, weights in whole["networks"].items():
        torch.testing.assert_close(continued["networks"][name], weights)
    path = export_weights(settings("whole"), tmp_path / "look.safetensors")
    assert load_network(path).codes.shape == (4, 32)
