"""What the benchmark of generated motions measures, on motions whose answer is known."""

from pathlib import Path

import pytest
import torch

from benchmarks import generation
from priors.humor.state import states_of
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import load_windows
from recon.body.model import BodyModel
from recon.formats.motions import save_motion
from tests.benchmarks.test_windows import turning
from tests.priors.test_humor import humor

SPLITS = """
subjects = {}
test = {subjects = ["07"]}
validation = {subjects = [], every_tenth = []}
licence = {non_commercial = []}
excluded = {clips = []}
windows = {test = {60 = [["07_01", 0.5], ["07_01", 0.0]]}}
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[generation.Scene, Path]:
    """Two windows of a body that turns on the spot, recorded at 120 Hz."""
    corpus = tmp_path_factory.mktemp("corpus")
    save_motion(corpus / "07_01.npz", turning(400, 120.0))
    (corpus / "splits.toml").write_text(SPLITS)
    body = BodyModel.load()
    windows = load_windows(corpus, Splits.load(corpus / "splits.toml"), "test", body)
    first = generation.first_states(corpus, windows, body)
    joints = body.pose(windows.truth).joints
    return generation.Scene(windows, first, joints, body), corpus


def test_first_states_are_those_of_the_windows(scene: tuple[generation.Scene, Path]) -> None:
    """Places are the windows'; the window at the clip's start has the one-sided velocity."""
    found, corpus = scene
    assert corpus.is_dir()
    torch.testing.assert_close(found.first.joints, found.truth[:, 0], atol=1e-5, rtol=0)
    inside = states_of(found.windows.truth, found.body)[:, 1]
    torch.testing.assert_close(  # turning evenly: the same in every frame, radians per second
        found.first.angular_velocity, inside.angular_velocity, atol=1e-3, rtol=0
    )


def test_the_nearest_sample_is_the_prediction(scene: tuple[generation.Scene, Path]) -> None:
    found, _ = scene
    exact, off = found.truth[:, None], found.truth[:, None] + torch.tensor([0.3, 0.0, 0.4])
    rows = generation.predicted(generation.Generated(torch.cat((off, exact), 1), None), found)
    mean = rows["mean"]
    assert mean["ade"] == pytest.approx(0, abs=1e-6)
    assert mean["fde"] == pytest.approx(0, abs=1e-6)
    assert mean["ade_mean"] == pytest.approx(0.25)
    assert mean["ade_of_mean"] == pytest.approx(0.25)  # half way to the one that is off
    assert mean["apd"] == pytest.approx(0.5)
    assert mean["apd_upright"] is None  # one of the two floats 40 cm above the ground for 2 s


def test_simple_predictions(scene: tuple[generation.Scene, Path]) -> None:
    found, _ = scene
    velocity = torch.tensor([[1.0, 2.0, 3.0]]).expand(2, 3)
    simple = generation.simple_predictions(found.first.replace(velocity=velocity))
    still, slide = simple["stand still"], simple["constant velocity"]
    assert torch.equal(still[:, 0, 30], found.first.joints)
    moved = (slide - still)[:, 0, 30]
    torch.testing.assert_close(moved, torch.tensor([1.0, 2.0, 0.0]).expand(2, 22, 3))


def test_recordings_are_cut_into_pieces() -> None:
    found = generation.pieces(turning(151 * 2 + 80, 30.0))
    assert [m.frames for m in found] == [151, 151, 80]
    assert len(generation.pieces(turning(151 + 59, 30.0))) == 1


def test_a_prior_that_never_moves(scene: tuple[generation.Scene, Path], monkeypatch) -> None:
    """Its samples are the first state for ever: as good as standing still, and not diverse."""
    found, corpus = scene
    monkeypatch.setattr(generation, "SAMPLES", 2)
    monkeypatch.setattr(generation, "UNCONDITIONED", 2)
    prior = humor(found.body, still=True)
    made = generation.generate(prior, found, 1.0, None)
    assert made.joints.shape == (2, 2, 151, 22, 3)
    rows = generation.predicted(made, found)["mean"]
    simple = generation.simple_predictions(found.first)["stand still"]
    still = generation.predicted(generation.Generated(simple, None), found)["mean"]
    assert rows["apd"] == pytest.approx(0, abs=1e-5)
    assert rows["ade"] == pytest.approx(still["ade"], abs=1e-4)
    feet = generation.feet_rows(prior, {"HuMoR": made}, found, {"07_01": corpus / "07_01.npz"})
    assert feet["from real states, HuMoR"]["count"] == 4
    assert feet["as recorded, up to 5 s"]["count"] == 1
    contacts = generation.contact_rows(prior, made, found)
    assert all(0 <= (row["accuracy"] or 0) <= 1 for row in contacts.values())
