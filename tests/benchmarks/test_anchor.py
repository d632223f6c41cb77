import math

import pytest
import torch

from benchmarks.anchor import label, turned
from benchmarks.anchor_baselines import LinearCycles, slerp
from benchmarks.anchor_interpolation import monotone, supports
from benchmarks.anchor_morphology import skinned
from benchmarks.anchor_reconstruction import box
from benchmarks.anchor_structure import clusters
from priors.anchor.frames import ANCHORS, Anchors
from recon.body.contacts import rest_heights, touching_heights
from recon.body.model import BodyModel
from recon.core import rotations as so3
from training.anchor.corpus import CycleBatch


def random_cycles(count, size=4, turn=0.3):
    random = torch.Generator().manual_seed(1)
    vectors = turn * torch.randn(count, 1, 20, 3, generator=random)
    waves = torch.linspace(0, math.pi, ANCHORS).sin()[:, None, None]
    anchors = Anchors(
        rotations=so3.exp(vectors * waves),
        translation=torch.randn(count, ANCHORS, 3, generator=random),
        times=torch.linspace(0.5, 2.0, count)[:, None] * torch.linspace(0, 1, ANCHORS),
    )
    return CycleBatch(anchors, torch.randn(count, size, generator=random))


def test_as_many_components_as_cycles_give_them_back():
    cycles = random_cycles(6)
    linear = LinearCycles.fit(cycles, 5)
    again = linear.decode(linear.codes(cycles))
    torch.testing.assert_close(again.anchors.pack(), cycles.anchors.pack(), atol=1e-4, rtol=0)
    torch.testing.assert_close(again.shape, cycles.shape, atol=1e-4, rtol=0)


def test_fewer_components_are_worse_and_orthonormal():
    cycles = random_cycles(8)
    errors = []
    for count in (2, 4):
        linear = LinearCycles.fit(cycles, count)
        torch.testing.assert_close(
            linear.directions @ linear.directions.mT, torch.eye(count), atol=1e-4, rtol=0
        )
        made = linear.decode(linear.codes(cycles)).anchors.translation
        errors.append((made - cycles.anchors.translation).square().mean())
    assert errors[1] < errors[0]
    with pytest.raises(ValueError, match="need more cycles"):
        LinearCycles.fit(cycles, 8)


def test_halfway_between_equal_cycles_is_the_same():
    cycles = random_cycles(6)
    linear = LinearCycles.fit(cycles, 5)
    for between in (slerp, linear.between):
        same = between(cycles, cycles, 0.5)
        torch.testing.assert_close(same.anchors.pack(), cycles.anchors.pack(), atol=1e-4, rtol=0)


def test_slerp_halves_angles_and_reaches_the_other_end():
    cycles = random_cycles(4)
    a, b = cycles[:2], cycles[2:]
    torch.testing.assert_close(
        slerp(a, b, 1.0).anchors.pack(), b.anchors.pack(), atol=1e-5, rtol=0
    )
    half = slerp(a, b, 0.5).anchors.rotations
    whole = so3.geodesic(a.anchors.rotations, b.anchors.rotations)
    torch.testing.assert_close(
        so3.geodesic(a.anchors.rotations, half), whole / 2, atol=2e-3, rtol=0
    )


def test_turns_are_to_the_left_and_labels_want_them():
    cycles = random_cycles(1)
    angle = torch.linspace(0, math.radians(40), ANCHORS)
    upright = so3.exp(torch.tensor([math.pi / 2, 0.0, 0.0]))
    rotations = cycles.anchors.rotations.clone()
    rotations[0, :, 0] = so3.about_z(angle) @ upright
    assert float(turned(cycles.anchors.replace(rotations=rotations))) == pytest.approx(40, abs=0.1)
    assert label("dataset-2_walk-turn-left_active_001", 40.0) == "turn-left"
    assert label("dataset-2_walk-turn-left_active_001", 5.0) is None
    assert label("dataset-2_walk-turn-right_active_001", 40.0) is None
    assert label("35_03", 0.0) == "walk"
    assert label("35_20", 0.0) == "run"
    assert label("06_01", 0.0) is None


def test_the_lowest_foot_is_held_within_reach():
    heights = rest_heights(BodyModel.load(), torch.zeros(16))
    joints = torch.zeros(3, 22, 3)
    joints[..., 2] = touching_heights(heights)
    joints[:, [8, 10, 11], 2] += 0.02
    joints[2, :, 2] += 0.2
    held = supports(joints, heights)
    assert held.nonzero().tolist() == [[0, 7], [1, 7]]


def test_durations_that_turn_back_are_not_monotone():
    along = torch.tensor([[1.0, 1.1, 1.2], [1.2, 1.1, 1.0], [1.0, 1.2, 1.1]])
    assert monotone(along).tolist() == [True, True, False]


def test_whiskers_leave_outliers_out():
    found = box(torch.tensor([1.0, 2.0, 3.0, 4.0, 100.0]))
    assert (found["med"], found["whishi"], found["fliers"]) == (3.0, 4.0, [100.0])


def test_separate_clusters_are_found():
    points = torch.tensor([[0.0, 0.0], [0.1, 0.0], [5.0, 0.0], [5.1, 0.0]])
    found = clusters(points, ["a", "a", "b", "b"])
    assert found["1-NN"] == 1.0
    assert found["silhouette"] > 0.9
    assert clusters(points, ["a", "b", "a", "b"])["1-NN"] == 0.0


def test_the_plain_surface_is_that_of_the_body_model():
    body, cycles = BodyModel.load(), random_cycles(1, 16)
    posed = body.pose(cycles.anchors.motion(cycles.shape, 1.0))
    surface, pelvis = skinned(body, cycles.anchors[0], cycles.shape[0])
    torch.testing.assert_close(surface, posed.vertices[0], atol=1e-4, rtol=0)
    torch.testing.assert_close(pelvis[:, 0], posed.joints[0, :, 0], atol=1e-4, rtol=0)
