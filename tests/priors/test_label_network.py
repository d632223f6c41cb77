"""The network of labels: its frame, neighbourhoods, what it must not depend on, its training."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from priors.labels.looking import CloudLabeller, in_network_frame, neighbouring_moments
from priors.labels.networks import (
    LabelNetwork,
    farthest_point_samples,
    kernel_weights,
    local_patches,
    squared_distances,
)
from priors.labels.regions import MIRRORED_REGIONS
from recon.body.model import BodyModel
from recon.formats.motions import save_motion
from tests.walking import a_walk
from training.labels.clouds import (
    POINTS,
    CloudCorpus,
    CloudVariation,
    LabelledClouds,
    at_most_points,
    augmented,
    mirrored_where,
    with_half_hidden,
)
from training.labels.train import LabelRun, LabelTraining, export_weights


@pytest.fixture
def labeller():
    return CloudLabeller(LabelNetwork().eval().requires_grad_(False))


def a_cloud(moments=4, points=90):
    """Points of a stretched blob, some of them absent."""
    random = torch.Generator().manual_seed(3)
    spread = torch.tensor([0.1, 0.25, 0.5])
    places = torch.randn(moments, points, 3, generator=random) * spread
    present = torch.rand(moments, points, generator=random) > 0.2
    return places.where(present[..., None], 0.0), present


def a_corpus(windows=6, random=None):
    """Windows of random points, of which some are off the body."""
    random = np.random.default_rng(0) if random is None else random
    points = random.normal(size=(windows, 3, POINTS, 3)) * [0.1, 0.2, 0.5]
    points = torch.from_numpy(points.astype(np.float16))
    regions = torch.from_numpy(random.integers(0, 12, points.shape[:-1], np.int8))
    regions[:, :, ::10] = -1
    counts = torch.from_numpy(random.integers(100, POINTS, points.shape[:2]))
    present = torch.arange(POINTS) < counts[..., None]
    eyes = torch.tensor([3.0, 0.0, 0.5]).expand(windows, 3)
    known = torch.ones(windows, dtype=torch.bool)
    return CloudCorpus(LabelledClouds(points, present, points, regions, eyes, known, known))


@pytest.mark.parametrize("has_eye", [True, False])
@pytest.mark.parametrize("level", [True, False])
def test_the_standard_frame_forgets_how_the_world_was_turned(has_eye, level):
    points, present = a_cloud()
    eyes = torch.tensor([[2.0, 1.0, 0.5]]).expand(4, 3)
    turn = Rotation.from_euler("z", 2.0) if level else Rotation.from_euler("xyz", [1, 2, 3])
    matrix = torch.from_numpy(turn.as_matrix()).float()
    flags = torch.full((4,), has_eye), torch.full((4,), level)
    # about the median, which turns with the cloud up to a few millimetres
    points = points - points.sum(1, keepdim=True) / present.sum(-1)[:, None, None]
    points = points.where(present[..., None], 0.0)
    one = in_network_frame(points, present, eyes, *flags)
    other = in_network_frame(points @ matrix.T, present, eyes @ matrix.T, *flags)
    assert (one.points - other.points).abs().max() < 0.1
    if has_eye and level:
        assert one.eyes[:, 1].abs().max() < 1e-5
        assert (one.eyes[:, 0] > 0).all()
    if level:
        heights = points[..., 2] - one.points[..., 2]
        assert heights[0][present[0]].std() < 1e-5


def test_patches_of_a_plane_have_its_normal():
    flat = torch.rand(1, 300, 3) * torch.tensor([1.0, 1.0, 0.0])
    turn = torch.from_numpy(Rotation.from_euler("xyz", [0.3, 0.5, 0.1]).as_matrix()).float()
    points = flat @ turn.T
    weights = kernel_weights(squared_distances(points[:, :20], points), 0.2)
    found = local_patches(points, weights)
    along = (found.normal @ turn[:, 2]).abs()
    assert (along / found.normal.norm(dim=-1)).min() > 0.9999
    assert along.min() > 0.99
    assert found.flatness.max() < 1e-4
    torch.testing.assert_close(weights.sum(-1), torch.ones(1, 20))


def test_points_on_a_line_have_no_normal():
    """Rounding once decided where such normals pointed, so that labels hung on the processor."""
    points = torch.zeros(1, 20, 3)
    points[0, :, 0] = torch.linspace(0.1, 0.9, 20)
    found = local_patches(points, kernel_weights(squared_distances(points[:, :5], points), 0.05))
    assert found.normal.norm(dim=-1).max() < 0.05


def test_spread_points_are_present_and_far_apart():
    points, present = a_cloud()
    index = farthest_point_samples(points, present, 10)
    assert present.gather(-1, index).all()
    chosen = points.take_along_dim(index[..., None], -2)
    near = squared_distances(chosen, chosen) + 10 * torch.eye(10)
    assert near.min().sqrt() > 0.15
    few = torch.zeros_like(present)
    few[:, 5] = True
    assert (farthest_point_samples(points, few, 3) == 5).all()


def test_labels_do_not_depend_on_the_order_of_points_nor_on_absent_rows(labeller):
    points, present = a_cloud()
    eyes = torch.tensor([[3.0, 0.0, 0.0]])
    said = labeller(points, present, 10.0, eyes)
    order = torch.randperm(points.shape[1])
    wild = torch.where(present[..., None], points, 7.0)
    other = labeller(wild[:, order], present[:, order], 10.0, eyes)
    shown = present[..., None]
    # a network that has learned nothing says either side, as rounding has it
    here, there = (
        torch.cat((each.abs()[..., :1], each[..., 1:]), -1)
        for each in (said.places[:, order], other.places)
    )
    torch.testing.assert_close(here, there, atol=1e-3, rtol=1e-2)
    assert torch.equal(said.regions.where(~shown, 0.0), torch.zeros_like(said.regions))
    torch.testing.assert_close(said.regions.sum(-1)[present], torch.ones(int(present.sum())))
    assert said.log_std[~present].abs().max() == 0


def test_clips_are_labelled_alike_alone_and_together(labeller, monkeypatch):
    points, present = a_cloud(moments=8)
    pair = torch.stack((points, points.flip(0))), torch.stack((present, present.flip(0)))
    together = labeller(*pair, 10.0)
    alone = labeller(points.flip(0), present.flip(0), 10.0)
    torch.testing.assert_close(together.places[1], alone.places, atol=1e-5, rtol=1e-4)
    monkeypatch.setattr("priors.labels.looking._CHUNK", 3)
    torch.testing.assert_close(labeller(*pair, 10.0).places, together.places, atol=1e-5, rtol=1e-4)


def test_moments_look_at_those_around_them_in_time():
    shown = torch.tensor([True] * 9)
    shown[1] = False
    index, known = neighbouring_moments(shown, [-6, -3, 0, 3, 6], 10.0)
    assert index[4].tolist() == [0, 1, 4, 7, 8]
    assert known[4].tolist() == [False, False, True, True, False]
    assert known[1].tolist() == [False, False, True, True, True]
    # one moment a second: no other one is near 0.3 s
    _, known = neighbouring_moments(shown, [-1, 0, 0, 0, 1], 1.0)
    assert known.tolist() == [[False, False, True, False, False]] * 9


def test_mirrored_clouds_have_the_labels_of_the_other_side():
    clouds = a_corpus().windows(torch.arange(6), 200, None)
    which = torch.tensor([True, False] * 3)
    other = mirrored_where(which, clouds)
    assert torch.equal(other.points[1], clouds.points[1])
    assert torch.equal(other.points[0, ..., 0], -clouds.points[0, ..., 0])
    assert torch.equal(other.places[0, ..., 0], -clouds.places[0, ..., 0])
    region = int(clouds.regions[0, 0, 1])
    assert int(other.regions[0, 0, 1]) == MIRRORED_REGIONS[region]
    assert torch.equal(other.regions < 0, clouds.regions < 0)
    again = mirrored_where(which, other)
    assert torch.equal(again.regions, clouds.regions)


def test_half_hidden_clouds_have_half_of_the_points():
    clouds = a_corpus().windows(torch.arange(6), 400, None)
    hidden = with_half_hidden(clouds, torch.Generator().manual_seed(0))
    share = (hidden.regions >= 0).flatten(1).sum(-1) / (clouds.regions >= 0).flatten(1).sum(-1)
    assert (share - 0.5).abs().max() < 0.01
    assert not (hidden.present & ~clouds.present).any()


def test_variations_keep_what_is_true_of_points():
    clouds = a_corpus().windows(torch.arange(6), 300, None)
    variation = CloudVariation(tilted=1.0, hidden=1.0, lost_limb=1.0)
    other = at_most_points(augmented(clouds, variation, torch.Generator().manual_seed(1)), 250)
    assert other.points.shape[2] == 250
    assert not other.level.any()
    # the points were their own places up to a turn and a mirror image
    lengths = other.points.norm(dim=-1) - other.places.norm(dim=-1)
    assert lengths[other.regions >= 0].abs().max() < 1e-2
    assert ((other.regions >= 0) <= other.present).all()
    assert (other.present.sum(-1) > 20).all()


def test_clouds_are_read_back(tmp_path):
    corpus = a_corpus()
    for number in range(2):
        corpus.clouds.save(tmp_path / f"clouds_000{number}.npz")
    again = CloudCorpus.load(tmp_path)
    for name, tensor in corpus.clouds.tensors().items():
        assert torch.equal(again.clouds.tensors()[name], torch.cat([tensor, tensor]))
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    with pytest.raises(ValueError, match="places, regions"):
        LabelledClouds.load(tmp_path / "other.npz")
    with pytest.raises(FileNotFoundError, match="make them first"):
        CloudCorpus.load(tmp_path / "nothing")


@pytest.mark.numerics
def test_training_learns_goes_on_and_is_exported(tmp_path):
    """An interrupted run ends with the weights of one that was not."""
    save_motion(tmp_path / "walk.npz", a_walk(BodyModel.load()))
    clouds = a_corpus(random=np.random.default_rng(1))
    settings = LabelTraining(
        tmp_path, tmp_path / "run", steps=4, windows=2, validate_every=2,
        variation=CloudVariation(fewest=40, most=60),
    )  # fmt: skip
    settings.out.mkdir()
    LabelRun(settings, clouds, clouds).train_to_end()
    whole = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert [row["step"] for row in whole["rows"]] == [2, 4]
    assert 0 <= whole["rows"][-1]["wrong"] <= 1
    path = tmp_path / "labels.safetensors"
    export_weights(settings, path)
    assert path.stat().st_size < 3e6
    labels = CloudLabeller.load(path)(*a_cloud(), 10.0)
    assert bool(labels.places.isfinite().all())
    other = dataclasses.replace(settings, rate=2e-3)
    with pytest.raises(ValueError, match="rate"):
        LabelRun(other, clouds, clouds)
