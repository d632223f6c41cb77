"""Laws of the pose prior, its training and its weights files."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from observations.joints3d import Joints3D
from priors.checkpoints import load_checkpoint
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, padded_batch
from recon.formats.motions import save_motion
from recon.method.priors import Prior
from recon.method.reconstruction import solve
from tests.laws import check_heading_invariance, check_prior
from training.__main__ import train
from training.pose import fit_density, score
from training.recordings import mirrored_rotations, poses_of
from training.settings import CorpusSettings
from training.weights import save_checkpoint

pytestmark = pytest.mark.numerics


def swinging(frames: int, seed: int, fps: float = 30.0) -> Motion:
    """A made-up clip: every joint swings slowly about an angle of its own."""
    generator = torch.Generator().manual_seed(seed)

    def random(*size: int) -> Tensor:
        return torch.randn(*size, generator=generator, dtype=torch.float64)

    time = torch.arange(frames, dtype=torch.float64)[:, None, None] / fps
    angles = (
        0.15 * random(1, 22, 3) + 0.15 * random(1, 22, 3) * (2 * time + random(1, 22, 3)).sin()
    )
    upright = so3.exp(torch.tensor([torch.pi / 2, 0.0, 0.0], dtype=torch.float64))
    rotations = so3.exp(angles)
    rotations = torch.cat((upright @ rotations[:, :1], rotations[:, 1:]), 1)
    walk = torch.tensor([0.0, 0.0, 0.9]) + 0.5 * time[:, 0] * torch.tensor([1.0, 0.2, 0.0])
    return Motion.create(walk.double(), rotations, 0.3 * random(16), fps)


@pytest.fixture(scope="module")
def prior() -> PosePrior:
    """A prior that has seen other clips of the same kind."""
    seen = torch.cat([swinging(60, seed).rotations[::10, 1:] for seed in range(100, 200)])
    density = fit_density(seen, 0.05, BodyModel.load())
    return PosePrior(density, PoseWeights.for_noise(0.04))


def test_it_is_a_prior(prior: PosePrior) -> None:
    assert isinstance(prior, Prior)


def test_it_keeps_the_laws_of_priors(prior: PosePrior) -> None:
    motion = padded_batch([swinging(6, 10), swinging(6, 11)])
    check_prior(prior, motion, tolerance=1e-6)  # radians, metres
    shift = torch.tensor([1.0, -2.0, 0.0], dtype=torch.float64)
    check_heading_invariance(prior, motion, 0.7, shift)


def test_every_motion_has_exact_variables(prior: PosePrior) -> None:
    motion = padded_batch([swinging(20, 0), swinging(12, 1)])
    again = prior.decode(prior.encode(motion)).motion
    torch.testing.assert_close(again.rotations, motion.rotations, rtol=0, atol=1e-12)
    torch.testing.assert_close(again.translation, motion.translation, rtol=0, atol=0)
    assert torch.equal(again.valid, motion.valid)


def test_coordinates_of_the_density_are_white() -> None:
    poses_seen = torch.cat([swinging(40, seed).rotations[:, 1:] for seed in range(80)])
    density = fit_density(poses_seen, 1e-6, BodyModel.load())
    z = density.coordinates(poses_seen)
    assert z.mean(0).abs().max() < 1e-6  # standard deviations
    torch.testing.assert_close(z.mT @ z / len(z), torch.eye(63).double(), rtol=0, atol=1e-3)
    torch.testing.assert_close(density.rotations(z), poses_seen, rtol=0, atol=1e-12)


def test_the_mean_pose_is_the_likeliest(prior: PosePrior) -> None:
    motion = swinging(7, 3)[None]
    mean = prior.density.mean.expand(1, 7, 21, 3, 3)
    at_mean = motion.replace(rotations=torch.cat((motion.rotations[..., :1, :, :], mean), -3))
    assert prior.decode(prior.encode(at_mean)).energies["pose"].item() == pytest.approx(
        0, abs=1e-18
    )
    assert prior.decode(prior.encode(motion)).energies["pose"].item() > 1


def test_the_energy_is_a_sum_at_30_hz_over_frames_that_exist(prior: PosePrior) -> None:
    motion = swinging(10, 4)
    single = prior.decode(prior.encode(motion[None])).energies["pose"]
    padded = padded_batch([motion, swinging(16, 5)])
    torch.testing.assert_close(prior.decode(prior.encode(padded)).energies["pose"][:1], single)
    double_rate = motion[None].replace(fps=60.0)
    torch.testing.assert_close(
        2 * prior.decode(prior.encode(double_rate)).energies["pose"], single
    )


def test_padding_leaves_the_variables_of_a_clip_alone(prior: PosePrior) -> None:
    alone = prior.encode(padded_batch([swinging(10, 4)])).synthesis[0]
    padded = prior.encode(padded_batch([swinging(10, 4), swinging(16, 5)])).synthesis[0]
    torch.testing.assert_close(padded[:10, :10], alone)
    torch.testing.assert_close(padded[10:, 10:], torch.eye(6).double())


def test_decoding_has_the_right_derivative(prior: PosePrior) -> None:
    start = prior.encode(swinging(4, 6)[None])

    def decoded(translation: Tensor, root: Tensor, pose: Tensor) -> Tensor:
        moved = start.replace(translation=translation, root=root, pose=pose)
        found = prior.decode(moved)
        return (
            torch.cat((found.motion.translation.flatten(), found.motion.rotations.flatten()))
            * found.energies["pose"].square()
        )

    inputs = [t.clone().requires_grad_() for t in (start.translation, start.root, start.pose)]
    assert torch.autograd.gradcheck(decoded, inputs, fast_mode=True)


def test_a_planted_motion_is_recovered_and_noise_goes(prior: PosePrior, body: BodyModel) -> None:
    truth = padded_batch([swinging(30, 7), swinging(30, 8)])
    joints = body.pose(truth).joints
    for noise, weights, limit in (
        (0.0, PoseWeights(pose=1e-7, shape=1e-7, acceleration=1e-4), 0.005),
        (0.04, PoseWeights.for_noise(0.04), 0.03),  # 6.4 cm as observed
    ):
        seen = joints + noise * torch.randn(joints.shape, dtype=torch.float64)
        everything = torch.ones(joints.shape[:-1], dtype=torch.bool)
        observed = Joints3D(seen, everything, tuple(range(22)), 30.0)
        result = solve([observed], prior.replace(weights=weights), body)
        error = (result.body.joints - joints).norm(dim=-1).mean((1, 2))
        assert error.max() < limit  # metres


def test_rare_poses_are_believed_less_for_about_a_second(prior: PosePrior) -> None:
    coordinates = torch.zeros(1, 90, 63, dtype=torch.float64)
    coordinates[:, 55:66] = 2.0  # standard deviations
    turns = prior.density.rotations(coordinates)
    swings = swinging(90, 0)
    turned = torch.cat((swings.rotations[None, :, :1], turns), 2)
    motion = padded_batch([swings]).replace(rotations=turned)
    share = prior.belief(0.02).share(motion)[0]
    assert torch.allclose(share[:40], torch.ones(40).double())  # the mean pose is wholly believed
    assert (share[55:66] < 0.1).all()
    assert torch.allclose(share[81:], torch.ones(9).double())


def test_negative_weights_are_refused() -> None:
    with pytest.raises(ValueError, match="acceleration"):
        PoseWeights(pose=1.0, shape=1.0, acceleration=-1.0)


def test_the_bundled_weights_load() -> None:
    prior = PosePrior.load()
    z = prior.density.coordinates(prior.density.mean)
    assert z.abs().max() < 1e-4  # single precision


def test_loading_is_strict(tmp_path: Path, prior: PosePrior) -> None:
    path = tmp_path / "pose.safetensors"
    tensors = prior.density.tensors()
    save_checkpoint(path, "pose", tensors, {"floor": 0.1})
    assert torch.equal(PosePrior.load(path).density.basis, prior.density.basis)
    assert load_checkpoint(path, "pose").settings == {"floor": 0.1}

    save_checkpoint(path, "pose", {**tensors, "mean": torch.zeros(20, 3, 3)}, {})
    with pytest.raises(ValueError, match=r"pose\.safetensors.*mean has shape \(20, 3, 3\)"):
        PosePrior.load(path)
    del tensors["basis"]
    save_checkpoint(path, "pose", {**tensors, "spare": torch.zeros(1)}, {})
    with pytest.raises(ValueError, match="basis is missing; spare is not expected"):
        PosePrior.load(path)
    save_checkpoint(path, "humor", tensors, {})
    with pytest.raises(ValueError, match="expected pose weights"):
        PosePrior.load(path)
    path.write_bytes(b"something else")
    with pytest.raises(ValueError, match="safetensors"):
        PosePrior.load(path)
    with pytest.raises(FileNotFoundError, match="absent"):
        PosePrior.load(tmp_path / "absent.safetensors")


def test_a_checkpoint_fills_a_network_or_names_the_layer(tmp_path: Path) -> None:
    path = tmp_path / "net.safetensors"
    save_checkpoint(path, "net", torch.nn.Linear(3, 2).state_dict(), {})
    network = torch.nn.Linear(3, 2)
    load_checkpoint(path, "net").copy_into(network)
    assert torch.equal(network.weight, load_checkpoint(path, "net").tensors["weight"])
    with pytest.raises(ValueError, match="weight has shape"):
        load_checkpoint(path, "net").copy_into(torch.nn.Linear(4, 2))


def test_mirroring_shows_the_mirrored_body(body: BodyModel) -> None:
    from recon.core.skeleton import MIRROR

    motion = swinging(5, 9)[None]
    flip = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    rotations = mirrored_rotations(motion.rotations)
    mirror = motion.replace(translation=motion.translation * flip, rotations=rotations)
    expected = (body.pose(motion).joints * flip)[..., list(MIRROR), :]
    torch.testing.assert_close(
        body.pose(mirror).joints, expected, rtol=0, atol=1e-3
    )  # metres: the body is symmetric to single precision and quantised weights
    twice = mirrored_rotations(rotations)
    assert torch.equal(twice, motion.rotations)


SPLITS = """
[subjects]
unknown = ["u_*"]
actor = ["dataset-2_*_normal_*"]
[test]
subjects = ["07", "actor"]
[validation]
subjects = ["06"]
every_tenth = ["dataset-*"]
[licence]
non_commercial = ["dataset-*"]
[excluded]
clips = ["08_02"]
[windows.test]
60 = [["07_01", 0.5]]
"""


@pytest.fixture
def splits(tmp_path: Path) -> Splits:
    path = tmp_path / "splits.toml"
    path.write_text(SPLITS)
    return Splits.load(path)


def test_splits_go_by_clip_names(splits: Splits, tmp_path: Path) -> None:
    names = ["u_1", "07_01", "06_03", "08_01", "08_02", "dataset-2_run_normal_001"]
    names += [f"dataset-1_bow_active_{i:03}" for i in range(11)]
    parts = splits.parts(names)
    assert splits.subject("u_1") == "unknown"
    assert splits.subject("dataset-2_run_normal_001") == "actor"
    assert "08_02" not in parts
    assert {n for n, p in parts.items() if p == "test"} == {"07_01", "dataset-2_run_normal_001"}
    assert {n for n, p in parts.items() if p == "validation"} == {
        "06_03", "dataset-1_bow_active_000", "dataset-1_bow_active_010"
    }  # fmt: skip
    assert splits.windows["test"] == {60: (("07_01", 0.5),)}
    assert splits.has_open_licence("08_01")
    assert not splits.has_open_licence("dataset-1_bow_active_000")

    broken = tmp_path / "broken.toml"
    broken.write_text("[test]")
    with pytest.raises(ValueError, match=r"broken\.toml"):
        Splits.load(broken)


def test_training_learns_from_training_clips_only(splits: Splits, tmp_path: Path) -> None:
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    for seed, name in enumerate(("08_01", "09_01", "06_01", "07_01", "dataset-1_bow_active_001")):
        save_motion(corpus / f"{name}.npz", swinging(120, seed, fps=60.0))
    settings = CorpusSettings(corpus, tmp_path, splits=tmp_path / "splits.toml")
    assert [c.name for c in settings.load_clips("train")] == ["08_01", "09_01"]
    assert settings.load_clips("train")[0].motion.frames == 60

    out = tmp_path / "pose.safetensors"
    train("pose", corpus, out)
    first = out.read_bytes()
    train("pose", corpus, out)
    assert out.read_bytes() == first
    checkpoint = load_checkpoint(out, "pose")
    assert checkpoint.settings["subjects"] == ["08", "09"]
    assert checkpoint.settings["poses"] == 2 * 2 * 20  # two clips of 2 s, 10 Hz, and mirrored
    log = (tmp_path / "pose.log").read_text()
    assert "held-out people" in log
    # it named the temporary file that the weights were written to first
    assert log.strip().endswith(f"wrote {out}")

    learned = poses_of(settings.load_clips("train"), 10.0, 500)[:, 1:]
    turned = learned @ so3.exp(torch.full((21, 3), 0.3))
    assert len(poses_of(settings.load_clips("train"), 10.0, most=7)) == 2 * 2 * 7
    density = PosePrior.load(out).density
    assert score(density, learned) > score(density, turned)


def test_a_corpus_without_motions_is_refused(splits: Splits, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="recon convert"):
        CorpusSettings(tmp_path / "empty", tmp_path).load_clips("train")
