"""`recon sample` and `recon predict` as a shell would call them: files, reports, exit codes."""

import json
from pathlib import Path

import pytest
import torch
from torch import Tensor

from priors.humor.mixture import Mixture
from priors.humor.state import canonical_state, independent_features, initial_features, states_of
from recon import cli
from recon.body.model import BodyModel
from recon.core.motion import Motion, MotionFile
from recon.formats.motions import load_motion, save_motion
from recon.view.files import view
from tests.priors.test_humor import humor, motions
from tests.priors.test_pose import swinging
from training.weights import save_humor


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of an untrained network, and first states near those of two made-up motions."""
    body = BodyModel.load()
    prior = humor(body)
    states = states_of(motions().to(dtype=torch.float32), body)[:, 0]
    known = independent_features()
    means = initial_features(canonical_state(states, prior.pelvis(motions().shape.float())))[
        :, known
    ]
    covariances = 1e-6 * torch.eye(len(known)).double().expand(2, len(known), len(known))
    initial = Mixture.create(torch.tensor([0.5, 0.5]), means.double(), covariances, known)
    path = tmp_path_factory.mktemp("weights") / "humor.safetensors"
    save_humor(path, prior.networks, initial, prior.error_whitening, {"data": "open"})
    return path


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A quarter of a second at 60 Hz, from second 2 on."""
    path = tmp_path_factory.mktemp("walk") / "walk.npz"
    motion = swinging(16, 3, fps=60.0).to(dtype=torch.float32).replace(start_time=2.0)
    body = BodyModel.load()
    save_motion(path, MotionFile(motion, body=body.name, checksum=body.checksum))
    return path


def recon_(*arguments: object) -> int:
    return cli.run([str(argument) for argument in arguments])


def test_samples_are_motion_files(weights: Path, tmp_path: Path, capsys) -> None:
    folder = tmp_path / "new" / "samples"
    ask = ("sample", "--count", 2, "--seconds", 0.2, "--weights", weights)
    assert recon_(*ask, "--out", folder, "--json") == cli.OK
    report = json.loads(capsys.readouterr().out)
    files = [load_motion(path) for path in sorted(folder.glob("*.npz"))]
    assert [Path(path).name for path in report["files"]] == ["sample_000.npz", "sample_001.npz"]
    assert report.items() <= json.loads((folder / "report.json").read_text()).items()
    assert report["settings"]["seed"] == 0
    assert report["settings"]["temperature"] == 0.9
    body = BodyModel.load()
    for file in files:
        assert (file.motion.frames, file.motion.fps, file.checksum) == (7, 30, body.checksum)
        assert file.joints is not None
        assert file.contacts is not None
        torch.testing.assert_close(file.joints, body.pose(file.motion).joints, atol=1e-5, rtol=0)
        assert 0 < file.contacts[:, 7:9].min() <= file.contacts.max() < 1
    assert not torch.equal(files[0].motion.translation, files[1].motion.translation)
    view(folder / "sample_000.npz", compare=folder / "sample_001.npz",
               png=tmp_path / "two.png")  # fmt: skip


def test_temperature_spreads_the_samples(weights: Path, walk: Path, tmp_path: Path) -> None:
    ask = ("predict", walk, "--samples", 2, "--seconds", 0.2, "--weights", weights)
    apart = []
    for temperature in (0, 0.5, 2):
        folder = tmp_path / str(temperature)
        assert recon_(*ask, "--out", folder, "--temperature", temperature) == cli.OK
        one, two = (load_motion(path).motion for path in sorted(folder.glob("*.npz")))
        apart.append(float((one.rotations - two.rotations).norm()))
    assert apart[0] < 1e-4
    assert 1e-3 < apart[1] < apart[2]


def test_a_prediction_goes_on_where_the_motion_ends(
    weights: Path, walk: Path, tmp_path: Path
) -> None:
    out = tmp_path / "more.npz"
    assert recon_("predict", walk, "--out", out, "--seconds", 0.1, "--weights", weights) == cli.OK
    known, more = load_motion(walk).motion, load_motion(out).motion
    assert more.frames == 4
    assert more.start_time == pytest.approx(2.25)
    torch.testing.assert_close(more.translation[0], known.translation[-1])
    torch.testing.assert_close(more.rotations[0], known.rotations[-1], atol=1e-5, rtol=0)
    report = json.loads((tmp_path / "more.npz.json").read_text())
    assert report["motion"] == str(walk)
    at = ("--at", 0.1, "--samples", 3, "--weights", weights)
    assert recon_("predict", walk, "--out", tmp_path / "some", *at) == cli.OK
    some = [load_motion(path).motion for path in sorted((tmp_path / "some").glob("*.npz"))]
    assert len(some) == 3
    for one in some:
        assert one.start_time == pytest.approx(2.1)
        torch.testing.assert_close(one.translation[0], known.translation[6])
    assert not torch.equal(some[0].translation, some[1].translation)
    again = tmp_path / "again"
    assert recon_("predict", walk, "--out", again, *at) == cli.OK
    same = load_motion(again / "prediction_001.npz").motion
    assert torch.equal(same.rotations, some[1].rotations)
    assert recon_("predict", walk, "--out", again, *at, "--seed", 1) == cli.OK
    other = load_motion(again / "prediction_001.npz").motion
    assert not torch.equal(other.rotations, some[1].rotations)


class StandIn:
    """A prior that glides everybody forward, at its own 20 Hz."""

    def sample(self, shape: Tensor, seconds: float, generator: torch.Generator) -> Motion:
        frames = round(seconds * 20) + 1
        rotations = torch.eye(3).repeat(len(shape), frames, 22, 1, 1)
        place = torch.rand(len(shape), 1, 3, generator=generator)
        path = place + torch.arange(frames)[:, None] * torch.tensor([0.0, 0.05, 0.0])
        return Motion.create(path, rotations, shape, 20.0)


def test_a_body_of_choice_is_sampled_from_humos(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("recon.api.generate.Humos.load", lambda *_: StandIn())
    ask = ("sample", "--prior", "humos", "--count", 2, "--seconds", 1, "--shape", "height=1.7")
    assert recon_(*ask, "--out", tmp_path / "made", "--json") == cli.OK
    report = json.loads(capsys.readouterr().out)
    assert (report["settings"]["shape"], report["warnings"]) == ("height=1.7", [])
    one, two = (load_motion(path) for path in sorted((tmp_path / "made").glob("*.npz")))
    assert (one.motion.frames, one.motion.fps) == (31, 30)
    assert float(BodyModel.load().height(two.motion.shape)) == pytest.approx(1.7, abs=1e-4)
    assert one.contacts is not None
    speed = one.motion.translation[:, 1].diff() * 30
    torch.testing.assert_close(speed, torch.ones(30), atol=1e-4, rtol=0)  # m/s at any rate
    assert not torch.equal(one.motion.translation, two.motion.translation)
    again = ("sample", "--prior", "humos", "--seconds", 1, "--fps", 60, "--shape", "5")
    assert recon_(*again, "--out", tmp_path / "a.npz") == cli.OK
    assert "5.0 standard deviations" in " ".join(capsys.readouterr().err.split())
    assert load_motion(tmp_path / "a.npz").motion.fps == 60


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("sample", "--out", "a", "--shape", "tall"), "--prior humos"),
        (("sample", "--out", "a", "--prior", "humos", "--temperature", 2), "an option of HuMoR"),
        (("sample", "--out", "a", "--prior", "humos", "--fps", 0), "fps: expected"),
        (("sample", "--out", "a", "--prior", "humos", "--device", "cuda"), "device: HUMOS"),
        (("sample", "--out", "a", "--prior", "humos", "--shape", "blue"), "blue"),
        (("sample", "--out", "a.npz", "--count", 2), "give a folder"),
        (("sample", "--out", "a", "--count", 0), "got 0"),
        (("sample", "--out", "a", "--seconds", "nan"), "seconds: expected"),
        (("sample", "--out", "a", "--weights", "nowhere.pt"), "nowhere.pt"),
        (("sample", "--out", "a", "--body", "nobody.npz"), "nobody.npz"),
        (("predict", "nowhere.npz", "--out", "a.npz"), "nowhere.npz"),
        (("predict", "WALK", "--out", "a.npz", "--samples", 2), "give a folder"),
        (("predict", "WALK", "--out", "a.npz", "--seconds", -1), "seconds: expected"),
        (("predict", "WALK", "--out", "a.npz", "--at", 0), "at: expected"),
        (("predict", "WALK", "--out", "a.npz", "--at", 0.3), "0.250 s"),
        (("predict", "WALK", "--out", "a.npz", "--at", "nan"), "at: expected"),
        (("predict", "ONE", "--out", "a.npz"), "a single frame"),
        (("predict", "OTHER", "--out", "a.npz"), "--body"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(
    arguments: tuple[object, ...], words: str, walk: Path, tmp_path: Path, capsys, monkeypatch
) -> None:
    file = load_motion(walk)
    save_motion(tmp_path / "one.npz", MotionFile(file.motion.window(0, 1)))
    save_motion(tmp_path / "other.npz", MotionFile(file.motion, body="mine", checksum="0123"))
    files = {"WALK": walk, "ONE": tmp_path / "one.npz", "OTHER": tmp_path / "other.npz"}
    place = tmp_path / "work"
    place.mkdir()
    monkeypatch.chdir(place)
    given = [files[a] if isinstance(a, str) and a in files else a for a in arguments]
    assert recon_(*given) == cli.BAD_INPUT
    assert words in capsys.readouterr().err
    assert list(place.iterdir()) == []
